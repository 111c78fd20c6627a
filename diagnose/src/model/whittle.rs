//! Whittle's likelihood of turbulence on one state, from the cross-spectral matrix of all channels.
//!
//! Turbulence on one state reaches all outputs that depend on it, each by its own transfer function; coloured
//! sensor noise stays in its channel. The likelihood is fast and approximate: it gives the start for the
//! exact likelihood.

use crate::thresholds::{MIN_SPECTRUM_SAMPLES, ROUNDING, SCORING_LIMITS, WEAK_CORRELATION};
use std::f64::consts::TAU;
use std::ops::ControlFlow;

use nalgebra::{Complex, DMatrix, DVector};
use whirlstand_linalg::fft;
use whirlstand_vehicle::Vehicle;

use crate::data::record::Data;
use crate::model::innovations::coefficients;
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_ident::identify::search::{Derivatives, Point, search};

pub(crate) type C = Complex<f64>;

/// Cross spectra of channels, averaged over segments and bands.
pub(crate) struct Cross {
    /// Frequencies, Hz.
    pub f: Vec<f64>,
    /// One-sided densities, channels x channels, per frequency.
    s: Vec<DMatrix<C>>,
    /// Widths of the bands, Hz.
    df: Vec<f64>,
    /// Number of independent averages per frequency.
    pub averages: Vec<f64>,
    pub channels: Vec<usize>,
}

/// Cross spectra of a residual; `None` when it is too short.
pub(crate) fn cross(data: &Data, residual: &[f64]) -> Option<Cross> {
    // Slower channels have other frequencies: they are excluded.
    let channels: Vec<usize> = (0..data.channels.len()).filter(|c| data.channels[*c].stride == 1).collect();
    let ranges = data.ranges();
    let n = channels.iter().map(|c| data.channels[*c].values.len()).min()?;
    // Long segments: slow turbulence shows in the lowest frequencies only, and averaging over bands replaces
    // averaging over segments.
    let mut length = 64;
    while length * 2 <= n / 2 && length < 4096 {
        length *= 2;
    }
    if channels.len() < 2 || n < MIN_SPECTRUM_SAMPLES {
        return None;
    }
    let window: Vec<f64> =
        (0..length).map(|k| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / length as f64).cos()).collect();
    let scale = 2.0 * data.period_s / window.iter().map(|w| w * w).sum::<f64>();
    let fft = fft::forward(length);
    let bins = length / 2;
    let mut s = vec![DMatrix::<C>::zeros(channels.len(), channels.len()); bins - 2];
    let mut segments = 0.0;
    for start in (0..=n - length).step_by(length / 2) {
        let spectra: Vec<Vec<C>> = channels
            .iter()
            .map(|c| {
                let r = &residual[ranges[*c].clone()][start..start + length];
                let mut buffer: Vec<C> = r.iter().zip(&window).map(|(r, w)| C::new(r * w, 0.0)).collect();
                fft.process(&mut buffer);
                buffer
            })
            .collect();
        for (bin, s) in s.iter_mut().enumerate() {
            for i in 0..channels.len() {
                for j in 0..channels.len() {
                    s[(i, j)] += spectra[i][bin + 2] * spectra[j][bin + 2].conj();
                }
            }
        }
        segments += 1.0;
    }
    s.iter_mut().for_each(|s| *s *= C::new(scale / segments, 0.0));
    let df = 1.0 / (length as f64 * data.period_s);
    // Neighbouring bins of Hann windows and overlapping segments are correlated: together they count as many
    // independent averages as the samples allow.
    let averages = n as f64 / length as f64;
    let mut bands = Cross { f: Vec::new(), df: Vec::new(), s: Vec::new(), averages: Vec::new(), channels };
    let mut from = 0;
    while from < s.len() {
        // Bands of about a tenth of their frequency.
        let until = (from + 1 + from / 10).min(s.len());
        let count = (until - from) as f64;
        let sum = s[from..until].iter().fold(DMatrix::zeros(s[from].nrows(), s[from].ncols()), |a, b| a + b);
        bands.f.push((from + until + 3) as f64 * 0.5 * df);
        bands.df.push(count * df);
        bands.averages.push(count * averages);
        bands.s.push(sum * C::new(1.0 / count, 0.0));
        from = until;
    }
    Some(bands)
}

/// Whittle's log-likelihood of independent noise of every channel with density `level(band, channel)`, and a
/// common source with density `common(band)` that reaches the channels by the responses `h`.
pub(crate) fn whittle(
    cross: &Cross,
    level: impl Fn(usize, usize) -> f64,
    common: impl Fn(usize) -> f64,
    h: &[Vec<C>],
) -> Option<f64> {
    let p = cross.channels.len();
    let mut sum = 0.0;
    for (band, s) in cross.s.iter().enumerate() {
        // Sherman-Morrison: the inverse of a diagonal matrix plus one outer product.
        let (mut value, mut reach, mut power) = (0.0, 0.0, 0.0);
        let mut turned = vec![C::new(0.0, 0.0); p];
        for c in 0..p {
            let r = level(band, c);
            value += r.ln();
            power += s[(c, c)].re / r;
            if let Some(h) = h.get(band) {
                reach += h[c].norm_sqr() / r;
                turned[c] = h[c] / r;
            }
        }
        if reach > 0.0 {
            let phi = common(band);
            let mut quadratic = 0.0;
            for i in 0..p {
                for j in 0..p {
                    quadratic += (turned[i].conj() * s[(i, j)] * turned[j]).re;
                }
            }
            // Power along the response and across it. Of the latter no more than rounding errors is left where the noise is
            // taken to be far below the motion: without a limit, noise of nothing would be infinitely likely.
            let along = quadratic / reach;
            let across = (power - along).max(ROUNDING * power);
            value += (1.0 + phi * reach).ln() + across + along / (1.0 + phi * reach);
        } else {
            value += power;
        }
        sum -= cross.averages[band] * value;
    }
    sum.is_finite().then_some(sum)
}

/// Frequency response of the channels to a force on each state's derivative: channels x states, per
/// frequency.
pub(crate) fn responses(vehicle: &Vehicle, data: &Data, cross: &Cross) -> Option<Vec<DMatrix<C>>> {
    let n = vehicle.states.len();
    let rows: Vec<usize> = cross.channels.iter().map(|c| data.channels[*c].output).collect();
    let c = DMatrix::from_fn(rows.len(), n, |i, j| C::new(vehicle.c[(rows[i], j)], 0.0));
    cross
        .f
        .iter()
        .map(|f| {
            let m =
                DMatrix::from_fn(n, n, |i, j| C::new(-vehicle.a[(i, j)], if i == j { TAU * f } else { 0.0 }));
            Some(&c * m.try_inverse()?)
        })
        .collect()
}

/// First-order shaped noise on one state beside autoregressive noise of the channels, up to second order.
/// Values: logarithms of standard deviation and bandwidth; of each channel's innovation; then the inverse
/// hyperbolic tangents of every channel's first partial correlation, and of its second.
pub(crate) struct Shaped {
    pub values: Vec<f64>,
    pub errors: Vec<f64>,
    pub likelihood: f64,
    /// Default start values: a bandwidth of 0.5 Hz and white noise.
    pub first: Vec<f64>,
}

impl Shaped {
    /// Partial correlations of a channel's noise; weak ones are set to zero.
    pub fn partial(&self, c: usize) -> [f64; 2] {
        let p = (self.values.len() - 2) / 3;
        let of = |order: usize| self.values[2 + order * p + c].tanh();
        match (of(1), of(2)) {
            (first, second) if second.abs() > WEAK_CORRELATION => {
                [if first == 0.0 { WEAK_CORRELATION * 1e-2 } else { first }, second]
            }
            (first, _) if first.abs() > WEAK_CORRELATION => [first, 0.0],
            _ => [0.0, 0.0],
        }
    }

    /// Number of parameters that are not zero.
    pub fn parameters(&self) -> usize {
        let p = (self.values.len() - 2) / 3;
        2 + p + (0..p).flat_map(|c| self.partial(c)).filter(|r| *r != 0.0).count()
    }

    pub(crate) fn fit(cross: &Cross, h: &[Vec<C>], period_s: f64) -> Option<Self> {
        let p = cross.channels.len();
        let mut start = vec![0.0; 2 + 3 * p];
        // Noise: the level of the upper part of the band. Turbulence: the power above that level.
        let upper = 3 * cross.f.len() / 4;
        for c in 0..p {
            let level: Vec<f64> = cross.s[upper..].iter().map(|s| s[(c, c)].re).collect();
            start[2 + c] = 0.5 * (whirlstand_logs::stats::median(&level) / (2.0 * period_s)).max(1e-300).ln();
        }
        // The turbulence size that gives a channel its measured power, smallest over the channels.
        let size = |bandwidth: f64| {
            let sizes = (0..p).filter_map(|c| {
                let (mut power, mut gain) = (0.0, 0.0);
                for (band, (s, h)) in cross.s.iter().zip(h).enumerate() {
                    power += s[(c, c)].re * cross.df[band];
                    gain += h[c].norm_sqr()
                        * Self::common(&[0.0, bandwidth.ln()], cross.f[band]).0
                        * cross.df[band];
                }
                (gain > 0.0).then(|| (power / gain).sqrt())
            });
            sizes.fold(f64::INFINITY, f64::min).clamp(1e-150, 1e150)
        };
        let mut first = Vec::new();
        let mut best: Option<Self> = None;
        for bandwidth in [0.1f64, 0.5, 2.5] {
            let mut values = start.clone();
            (values[0], values[1]) = (size(bandwidth).ln(), bandwidth.ln());
            if bandwidth == 0.5 {
                first.clone_from(&values);
            }
            let found = Self::search(cross, h, period_s, values);
            if let Some(found) = found
                && best.as_ref().is_none_or(|b| found.likelihood > b.likelihood)
            {
                best = Some(found);
            }
        }
        best.map(|b| Self { first, ..b })
    }

    /// Spectral density of the shaped noise, and its derivatives by the first two values.
    fn common(values: &[f64], f: f64) -> (f64, [f64; 2]) {
        let (std, a, w) = (values[0].exp(), TAU * values[1].exp(), TAU * f);
        let phi = 4.0 * std * std * a / (a * a + w * w);
        (phi, [2.0 * phi, phi * (1.0 - 2.0 * a * a / (a * a + w * w))])
    }

    /// Spectral density of a channel's own noise, and its derivatives by size and both partial correlations.
    fn own(values: &[f64], c: usize, p: usize, f: f64, period_s: f64) -> (f64, [f64; 3]) {
        let partial = [values[2 + p + c].tanh(), values[2 + 2 * p + c].tanh()];
        let [a, b] = coefficients(partial);
        let (one, two) = ((TAU * f * period_s).cos(), (2.0 * TAU * f * period_s).cos());
        let denominator = 1.0 + a * a + b * b - 2.0 * a * (1.0 - b) * one - 2.0 * b * two;
        let level = 2.0 * period_s * (2.0 * values[2 + c]).exp() / denominator;
        let by_a = 2.0 * a - 2.0 * (1.0 - b) * one;
        let by_b = 2.0 * b + 2.0 * a * one - 2.0 * two;
        let by_first = by_a * (1.0 - partial[1]);
        let by_second = by_b - by_a * partial[0];
        let of = |by: f64, partial: f64| -level * by / denominator * (1.0 - partial * partial);
        (level, [2.0 * level, of(by_first, partial[0]), of(by_second, partial[1])])
    }

    fn likelihood(cross: &Cross, h: &[Vec<C>], period_s: f64, values: &[f64]) -> Option<f64> {
        let p = cross.channels.len();
        let level = |band: usize, c: usize| Self::own(values, c, p, cross.f[band], period_s).0;
        whittle(cross, level, |band| Self::common(values, cross.f[band]).0, h)
    }

    /// Fisher information and gradient of Whittle's likelihood.
    fn scoring(cross: &Cross, h: &[Vec<C>], period_s: f64, values: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
        let (p, k) = (cross.channels.len(), values.len());
        let (mut information, mut gradient) = (DMatrix::zeros(k, k), DVector::zeros(k));
        for (band, measured) in cross.s.iter().enumerate() {
            let (weight, f, h) = (cross.averages[band], cross.f[band], &h[band]);
            let (phi, by_common) = Self::common(values, f);
            let own: Vec<(f64, [f64; 3])> = (0..p).map(|c| Self::own(values, c, p, f, period_s)).collect();
            let reach: f64 = (0..p).map(|c| h[c].norm_sqr() / own[c].0).sum();
            let inverse = DMatrix::from_fn(p, p, |i, j| {
                let outer = (h[i] / own[i].0) * (h[j] / own[j].0).conj() * (phi / (1.0 + phi * reach));
                if i == j { C::new(1.0 / own[i].0, 0.0) - outer } else { -outer }
            });
            let v: Vec<C> = (0..p).map(|i| (0..p).map(|j| inverse[(i, j)] * h[j]).sum()).collect();
            let through: f64 = (0..p).map(|c| (h[c].conj() * v[c]).re).sum();
            let excess = &inverse * measured * &inverse - &inverse;
            let along: f64 = {
                let mut sum = 0.0;
                for i in 0..p {
                    for j in 0..p {
                        sum += (h[i].conj() * excess[(i, j)] * h[j]).re;
                    }
                }
                sum
            };
            for a in 0..2 {
                gradient[a] += weight * by_common[a] * along;
                for b in 0..2 {
                    information[(a, b)] += weight * by_common[a] * by_common[b] * through * through;
                }
                for (c, (_, by_own)) in own.iter().enumerate() {
                    for (d, by) in by_own.iter().enumerate() {
                        let value = weight * by_common[a] * by * v[c].norm_sqr();
                        let at = 2 + d * p + c;
                        information[(a, at)] += value;
                        information[(at, a)] += value;
                    }
                }
            }
            for (c, (_, by_c)) in own.iter().enumerate() {
                for (d, by) in by_c.iter().enumerate() {
                    gradient[2 + d * p + c] += weight * by * excess[(c, c)].re;
                }
                for (e, (_, by_e)) in own.iter().enumerate() {
                    let alike = weight * inverse[(c, e)].norm_sqr();
                    for (i, x) in by_c.iter().enumerate() {
                        for (j, y) in by_e.iter().enumerate() {
                            information[(2 + i * p + c, 2 + j * p + e)] += alike * x * y;
                        }
                    }
                }
            }
        }
        (information, gradient)
    }

    /// Maximises Whittle's likelihood by Fisher scoring.
    fn search(cross: &Cross, h: &[Vec<C>], period_s: f64, values: Vec<f64>) -> Option<Self> {
        let at = |values: &[f64]| {
            let likelihood = Self::likelihood(cross, h, period_s, values)?;
            Some(Scored { cross, h, period_s, values: values.to_vec(), likelihood, information: None })
        };
        let bounds = vec![(f64::NEG_INFINITY, f64::INFINITY); values.len()];
        let next = |_: &Scored<'_>, values: &[f64], _: &DVector<f64>| at(values);
        let (best, _) = search(at(&values)?, &bounds, SCORING_LIMITS, next, |_, _| ControlFlow::Continue(()));
        let information =
            best.information.unwrap_or_else(|| Self::scoring(cross, h, period_s, &best.values).0);
        let covariance = pseudo_inverse(&information)?;
        let errors = (0..best.values.len()).map(|i| covariance[(i, i)].max(0.0).sqrt()).collect();
        Some(Self { values: best.values, errors, likelihood: best.likelihood, first: Vec::new() })
    }
}

/// Parameter values with their Whittle likelihood.
struct Scored<'c> {
    cross: &'c Cross,
    h: &'c [Vec<C>],
    period_s: f64,
    values: Vec<f64>,
    likelihood: f64,
    information: Option<DMatrix<f64>>,
}

impl Point for Scored<'_> {
    fn position(&self) -> &[f64] {
        &self.values
    }

    fn cost(&self) -> f64 {
        -self.likelihood
    }

    fn derivatives(&mut self) -> Option<Derivatives> {
        let (information, right) = Shaped::scoring(self.cross, self.h, self.period_s, &self.values);
        self.information = Some(information.clone());
        Some(Derivatives { information, right })
    }
}
