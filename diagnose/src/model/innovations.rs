//! Kalman filter of a residual that is turbulence on one state beside noise of the channels.

use crate::thresholds::{MAX_TRANSIENT_STEPS, SETTLED_GAIN_CHANGE};
use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Vehicle, discretise};

use crate::data::record::Data;

/// Parameters of the noises: logarithms of the turbulence's standard deviation and bandwidth, then for every
/// channel's own noise the logarithm of its innovation and its partial correlations.
#[derive(Debug, Clone, PartialEq)]
pub struct Noises {
    /// ln(std) and ln(bandwidth_hz).
    pub common: [f64; 2],
    /// ln(std) of the innovation of each channel's own noise.
    pub own: Vec<f64>,
    /// Partial correlations of each channel's own noise: second order, first order with a second zero, or
    /// white.
    pub partial: Vec<[f64; 2]>,
}

impl Noises {
    pub(super) fn count(&self) -> usize {
        2 + 3 * self.own.len()
    }

    /// True for a parameter that is fitted; correlations of zero stay zero.
    fn is_open(&self, value: usize) -> bool {
        let from = 2 + self.own.len();
        value < from || self.partial[(value - from) / 2][(value - from) % 2] != 0.0
    }

    /// Indices of the fitted parameters.
    pub(super) fn open(&self) -> impl Iterator<Item = usize> {
        (0..self.count()).filter(|i| self.is_open(*i))
    }

    /// Number of fitted parameters.
    pub fn parameters(&self) -> usize {
        self.open().count()
    }

    /// All parameters moved by a step: logarithms, then the inverse hyperbolic tangents of the correlations.
    /// Size and bandwidth are correlated: the first step is the density at high frequencies, the second moves
    /// at constant density.
    pub(super) fn moved(&self, step: &[f64]) -> Self {
        let mut next = self.clone();
        next.common[0] -= 0.5 * step[1];
        next.common.iter_mut().chain(&mut next.own).zip(step).for_each(|(v, d)| *v += d);
        let partial = next.partial.iter_mut().flatten().zip(&step[2 + self.own.len()..]);
        for (r, d) in partial.filter(|(r, _)| **r != 0.0) {
            *r = (r.atanh() + d).tanh().clamp(-0.9999, 0.9999);
        }
        next
    }
}

/// Coefficients of e(k) = a e(k-1) + b e(k-2) + innovation, from partial correlations (Levinson-Durbin).
pub fn coefficients(partial: [f64; 2]) -> [f64; 2] {
    [partial[0] * (1.0 - partial[1]), partial[1]]
}

/// Kalman filter for one set of noises: states of the vehicle, the turbulence, and two states for each
/// channel with coloured noise.
pub(super) struct Filter {
    f: DMatrix<f64>,
    f_transposed: DMatrix<f64>,
    q: DMatrix<f64>,
    h: DMatrix<f64>,
    h_transposed: DMatrix<f64>,
    r: DMatrix<f64>,
    /// State index and stationary variance of the turbulence, with which its covariance begins.
    turbulence: (usize, f64),
}

/// Gain, inverse of the lower factor of the innovations' covariance, logarithm of its determinant.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Update {
    gain: DMatrix<f64>,
    pub inverse_factor: DMatrix<f64>,
    pub log_det: f64,
}

impl Update {
    /// True when gain and innovation covariance agree. The state covariance is not compared: states that no
    /// channel observes grow without bound.
    pub fn is_near(&self, other: &Self) -> bool {
        let pairs = self.gain.iter().zip(&other.gain);
        pairs.fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) < SETTLED_GAIN_CHANGE * other.gain.amax()
    }
}

impl Filter {
    pub fn new(data: &Data, vehicle: &Vehicle, state: usize, noises: &Noises) -> Option<Self> {
        let (n, p) = (vehicle.states.len(), data.channels.len());
        let coloured: Vec<usize> = (0..p).filter(|c| noises.partial[*c] != [0.0; 2]).collect();
        let order = n + 1 + 2 * coloured.len();
        let (std, rate) = (noises.common[0].exp(), std::f64::consts::TAU * noises.common[1].exp());
        let mut push = DMatrix::zeros(n, 1);
        push[(state, 0)] = 1.0;
        let (phi, gamma) = discretise(&vehicle.a, &push, data.period_s).ok()?;
        let decay = (-rate * data.period_s).exp();
        let mut f = DMatrix::zeros(order, order);
        f.view_mut((0, 0), (n, n)).copy_from(&phi);
        f.view_mut((0, n), (n, 1)).copy_from(&gamma);
        f[(n, n)] = decay;
        let mut q = DMatrix::zeros(order, order);
        q[(n, n)] = std * std * (1.0 - decay * decay);
        let (mut h, mut r) = (DMatrix::zeros(p, order), DMatrix::zeros(p, p));
        for (c, channel) in data.channels.iter().enumerate() {
            for j in 0..n {
                h[(c, j)] = vehicle.c[(channel.output, j)];
            }
            let variance = (2.0 * noises.own[c]).exp();
            match coloured.iter().position(|i| *i == c) {
                None => r[(c, c)] = variance,
                Some(i) => {
                    let at = n + 1 + 2 * i;
                    let [a, b] = coefficients(noises.partial[c]);
                    h[(c, at)] = 1.0;
                    f[(at, at)] = a;
                    f[(at, at + 1)] = b;
                    f[(at + 1, at)] = 1.0;
                    q[(at, at)] = variance;
                }
            }
        }
        let (f_transposed, h_transposed) = (f.transpose(), h.transpose());
        Some(Self { f, f_transposed, q, h, h_transposed, r, turbulence: (n, std * std) })
    }

    /// Number of states.
    pub fn order(&self) -> usize {
        self.f.nrows()
    }

    /// Covariance at the start: `open` is the standard deviation of the vehicle's initial state.
    pub fn start(&self, open: f64) -> DMatrix<f64> {
        let mut covariance = self.q.clone();
        let (turbulence, variance) = self.turbulence;
        covariance[(turbulence, turbulence)] = variance;
        (0..turbulence).for_each(|i| covariance[(i, i)] += open * open);
        covariance
    }

    /// Matrix from states and samples to the next states and the normalised innovations.
    pub fn step(&self, update: &Update) -> DMatrix<f64> {
        let ((p, n), gain, factor) = (self.h.shape(), &update.gain, &update.inverse_factor);
        let mut step = DMatrix::zeros(n + p, n + p);
        step.view_mut((0, 0), (n, n)).copy_from(&(&self.f - gain * &self.h));
        step.view_mut((0, n), (n, p)).copy_from(gain);
        step.view_mut((n, 0), (p, n)).copy_from(&(-factor * &self.h));
        step.view_mut((n, n), (p, p)).copy_from(factor);
        step
    }

    /// The update for a predicted covariance, which is advanced to the next step.
    pub fn update(&self, covariance: &mut DMatrix<f64>) -> Option<Update> {
        let crossed = &*covariance * &self.h_transposed;
        let factor = (&self.h * &crossed + &self.r).cholesky()?;
        let log_det = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        let p = self.h.nrows();
        let mut inverse_factor = DMatrix::identity(p, p);
        factor.l_dirty().solve_lower_triangular_mut(&mut inverse_factor);
        let shifted = &self.f * &crossed;
        // Divided by the innovations' standard deviations; the gain is this times the inverse factor.
        let scaled = &shifted * inverse_factor.transpose();
        let gain = &scaled * &inverse_factor;
        let mut after = &self.f * &*covariance * &self.f_transposed;
        after += &self.q;
        after.gemm(-1.0, &scaled, &scaled.transpose(), 1.0);
        // Symmetric up to rounding, and kept so.
        for i in 0..after.nrows() {
            for j in 0..i {
                let mean = 0.5 * (after[(i, j)] + after[(j, i)]);
                (after[(i, j)], after[(j, i)]) = (mean, mean);
            }
        }
        *covariance = after;
        Some(Update { gain, inverse_factor, log_det })
    }
}

/// Whitens all channels together by the innovations of the settled filter for turbulence and the channels'
/// own noise.
#[derive(Debug, Clone, PartialEq)]
pub struct Whitener {
    /// Matrix from the filter's states and a row of samples to the next states and the whitened row.
    step: DMatrix<f64>,
    /// Number of the filter's states.
    order: usize,
    log_det: f64,
    /// Number of the noises' parameters.
    pub parameters: usize,
}

impl Whitener {
    /// The whitener for noises that `climb` has found.
    pub fn new(data: &Data, vehicle: &Vehicle, state: usize, noises: &Noises) -> Option<Self> {
        let filter = Filter::new(data, vehicle, state, noises)?;
        let mut covariance = filter.start(0.0);
        let mut last = None;
        for _ in 0..10 * MAX_TRANSIENT_STEPS {
            let update = filter.update(&mut covariance)?;
            let settled = last.as_ref().is_some_and(|l: &Update| l.is_near(&update));
            last = Some(update);
            if settled {
                break;
            }
        }
        let update = last?;
        let (order, step) = (filter.order(), filter.step(&update));
        Some(Self { step, order, log_det: update.log_det, parameters: noises.parameters() })
    }

    /// Logarithm of the determinant of one step's innovations.
    pub fn log_det(&self) -> f64 {
        self.log_det
    }

    /// Normalised innovations, uncorrelated between channels. All channels must have one sample per step.
    pub fn filter(&self, data: &Data, samples: &[f64]) -> Vec<f64> {
        self.run(data, samples, |_| {})
    }

    /// One state of the filter over time; the states of the vehicle come first, then the turbulence.
    pub fn states(&self, data: &Data, samples: &[f64], index: usize) -> Vec<f64> {
        let mut values = Vec::with_capacity(data.steps);
        self.run(data, samples, |x| values.push(x[index]));
        values
    }

    fn run(&self, data: &Data, samples: &[f64], mut each: impl FnMut(&DVector<f64>)) -> Vec<f64> {
        let ranges = data.ranges();
        let rows = ranges.iter().map(std::ops::Range::len).min().unwrap_or(0);
        let mut white = vec![0.0; samples.len()];
        let mut now = DVector::zeros(self.step.nrows());
        let mut next = now.clone();
        for k in 0..rows {
            for (c, range) in ranges.iter().enumerate() {
                now[self.order + c] = samples[range.start + k];
            }
            next.gemv(1.0, &self.step, &now, 0.0);
            for (c, range) in ranges.iter().enumerate() {
                white[range.start + k] = next[self.order + c];
            }
            std::mem::swap(&mut now, &mut next);
            each(&now);
        }
        white
    }
}
