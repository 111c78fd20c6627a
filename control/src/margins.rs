//! Stability margins of a sampled loop, broken where the commands enter the plant.

use nalgebra::DMatrix;
use serde::Serialize;
use whirlstand_linalg::{C64, DecompositionError, complex, singular_values};

use crate::hessenberg;

/// The return ratio of a loop opened at the plant's inputs, as a discrete state space: `L(z) = c (zI - a)^-1 b`,
/// m x m, with the closed loop `w = -L w`.
#[derive(Debug, Clone, PartialEq)]
pub struct ReturnRatio {
    /// System matrix.
    pub a: DMatrix<f64>,
    /// Input matrix.
    pub b: DMatrix<f64>,
    /// Output matrix.
    pub c: DMatrix<f64>,
    /// Period, s.
    pub period_s: f64,
}

/// Margins of one input's loop, the other loops closed. A value is absent where there is no such limit.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct LoopMargins {
    /// Smallest factor above one on the loop gain at which stability is lost.
    pub gain_increase: Option<f64>,
    /// Largest factor below one on the loop gain at which stability is lost.
    pub gain_decrease: Option<f64>,
    /// Smallest phase change, either way, at which stability is lost, deg.
    pub phase_deg: Option<f64>,
    /// Frequency of the crossover with that phase margin, rad/s.
    pub crossover_rad_s: Option<f64>,
    /// Smallest extra delay at which stability is lost, s.
    pub delay_s: Option<f64>,
}

/// Margins against changes at all inputs at once.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MultivariableMargins {
    /// Smallest singular value of the return difference `I + L` over frequency.
    pub min_return_difference: f64,
    /// Peak of the sensitivity, the inverse of the smallest return difference.
    pub max_sensitivity: f64,
    /// Symmetric disk margin (Seiler, Packard and Gahinet, IEEE Control Syst. Mag. 40, 2020): stable for all
    /// independent gains and phases at the inputs within the disk.
    pub disk: f64,
    /// Smallest gain that the disk guarantees, for all inputs at once.
    pub disk_gain_low: f64,
    /// Largest gain that the disk guarantees, for all inputs at once.
    pub disk_gain_high: Option<f64>,
    /// Phase that the disk guarantees, deg.
    pub disk_phase_deg: f64,
    /// Frequency of the smallest disk, rad/s.
    pub disk_frequency_rad_s: f64,
}

/// Number of states from which a frequency response is computed from the Hessenberg form
/// ([`ReturnRatio::compressed`]): the past commands of a delayed input are many states.
const LARGE: usize = 24;

impl ReturnRatio {
    /// The same ratio with `a` in Hessenberg form, where a frequency costs n^2 and not n^3 (Laub, IEEE Trans.
    /// Autom. Control 26, 1981). A small one is unchanged.
    #[must_use]
    pub fn compressed(self) -> Self {
        if self.a.nrows() <= LARGE {
            return self;
        }
        let (q, a) = nalgebra::Hessenberg::new(self.a).unpack();
        Self { a, b: q.tr_mul(&self.b), c: self.c * q, period_s: self.period_s }
    }

    pub(crate) fn inputs(&self) -> usize {
        self.b.ncols()
    }

    /// `L(e^{i w T})`, m x m, at the frequency `w` in rad/s; not finite at a pole.
    pub fn at(&self, w: f64) -> DMatrix<C64> {
        let z = C64::from_polar(1.0, w * self.period_s);
        let n = self.a.nrows();
        if n > LARGE {
            return match hessenberg::solve_shifted(&self.a, &self.b, z) {
                Some(x) => complex(&self.c) * x,
                None => DMatrix::from_element(self.inputs(), self.inputs(), C64::new(f64::NAN, f64::NAN)),
            };
        }
        let mut shifted = -complex(&self.a);
        (0..n).for_each(|i| shifted[(i, i)] += z);
        match shifted.lu().solve(&complex(&self.b)) {
            Some(x) => complex(&self.c) * x,
            None => DMatrix::from_element(self.inputs(), self.inputs(), C64::new(f64::NAN, f64::NAN)),
        }
    }

    /// The return ratio of loop `i` with the others closed.
    pub(crate) fn loop_at(&self, i: usize, w: f64) -> C64 {
        let m = self.inputs();
        let difference = DMatrix::<C64>::identity(m, m) + self.at(w);
        match difference.try_inverse() {
            Some(s) => C64::new(1.0, 0.0) / s[(i, i)] - C64::new(1.0, 0.0),
            None => C64::new(-1.0, 0.0),
        }
    }

    /// Frequencies from a millionth of the Nyquist frequency to the Nyquist frequency, rad/s.
    fn grid(&self) -> Vec<f64> {
        const COUNT: usize = 1200;
        let top = std::f64::consts::PI / self.period_s;
        let bottom = top * 1e-6;
        (0..=COUNT).map(|k| bottom * (top / bottom).powf(k as f64 / COUNT as f64)).collect()
    }

    /// Margins of the loop of input `i`, the other loops closed.
    pub fn loop_margins(&self, i: usize) -> LoopMargins {
        let grid = self.grid();
        let values: Vec<C64> = grid.iter().map(|&w| self.loop_at(i, w)).collect();
        let mut margins = LoopMargins::default();
        let mut gain = |real: f64| {
            if real < 0.0 {
                let factor = -1.0 / real;
                if factor > 1.0 {
                    margins.gain_increase =
                        Some(margins.gain_increase.map_or(factor, |g: f64| g.min(factor)));
                } else {
                    margins.gain_decrease =
                        Some(margins.gain_decrease.map_or(factor, |g: f64| g.max(factor)));
                }
            }
        };
        for (w, v) in grid.windows(2).zip(values.windows(2)) {
            if v[0].im * v[1].im < 0.0 && (v[0].re < 0.0 || v[1].re < 0.0) {
                let at = self.bisect(i, w[0], w[1], |l| l.im);
                gain(self.loop_at(i, at).re);
            }
        }
        if let Some(last) = values.last() {
            // At the Nyquist frequency the response is real.
            gain(last.re);
        }
        let level = |l: C64| l.norm() - 1.0;
        for (w, v) in grid.windows(2).zip(values.windows(2)) {
            if level(v[0]) * level(v[1]) < 0.0 {
                let at = self.bisect(i, w[0], w[1], level);
                // Distance of the crossing from -1, as the angle of additional lag.
                let lag =
                    (std::f64::consts::PI + self.loop_at(i, at).arg()).rem_euclid(std::f64::consts::TAU);
                let phase = lag.min(std::f64::consts::TAU - lag).to_degrees();
                if margins.phase_deg.is_none_or(|p| phase < p) {
                    margins.phase_deg = Some(phase);
                    margins.crossover_rad_s = Some(at);
                }
                let delay = lag / at;
                if margins.delay_s.is_none_or(|d| delay < d) {
                    margins.delay_s = Some(delay);
                }
            }
        }
        margins
    }

    fn bisect(&self, i: usize, low: f64, high: f64, f: impl Fn(C64) -> f64) -> f64 {
        let (mut low, mut high) = (low, high);
        let sign = f(self.loop_at(i, low)).signum();
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if f(self.loop_at(i, middle)).signum() == sign { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Margins against simultaneous changes at all inputs.
    ///
    /// # Errors
    /// [`DecompositionError`] when singular values of the loop do not converge.
    pub fn multivariable(&self) -> Result<MultivariableMargins, DecompositionError> {
        let (_, min_return_difference) = self.minimum(|w| self.smallest_difference(w))?;
        let least = std::cell::Cell::new(f64::INFINITY);
        let (frequency, alpha) = self.minimum(|w| {
            let radius = self.disk_radius(w, least.get())?;
            least.set(least.get().min(radius));
            Ok(radius)
        })?;
        Ok(MultivariableMargins {
            min_return_difference,
            max_sensitivity: 1.0 / min_return_difference,
            disk: alpha,
            disk_gain_low: ((2.0 - alpha) / (2.0 + alpha)).max(0.0),
            disk_gain_high: (alpha < 2.0).then(|| (2.0 + alpha) / (2.0 - alpha)),
            disk_phase_deg: 2.0 * (0.5 * alpha).atan().to_degrees(),
            disk_frequency_rad_s: frequency,
        })
    }

    /// Smallest singular value of the return difference at the frequency `w`, rad/s; infinite at a pole.
    pub(crate) fn smallest_difference(&self, w: f64) -> Result<f64, DecompositionError> {
        let m = self.inputs();
        let difference = DMatrix::<C64>::identity(m, m) + self.at(w);
        if difference.iter().any(|v| !v.re.is_finite() || !v.im.is_finite()) {
            return Ok(f64::INFINITY);
        }
        Ok(singular_values(&difference)?.min())
    }

    /// Inverse of the structured singular value of `(S - T) / 2`, with `S - T = (I - L)(I + L)^-1`, for
    /// independent changes at the inputs. Radii above `enough` need not be exact.
    fn disk_radius(&self, w: f64, enough: f64) -> Result<f64, DecompositionError> {
        let m = self.inputs();
        let identity = DMatrix::<C64>::identity(m, m);
        let l = self.at(w);
        if l.iter().any(|v| !v.re.is_finite() || !v.im.is_finite()) {
            return Ok(f64::INFINITY);
        }
        let Some(s) = (&identity + &l).try_inverse() else { return Ok(0.0) };
        let difference = (&identity - l) * s * C64::new(0.5, 0.0);
        let unscaled = 1.0 / singular_values(&difference)?.max();
        Ok(if unscaled >= enough { unscaled } else { 1.0 / structured_singular_value(difference)? })
    }

    /// Location and value of the minimum of `f` over frequency: on the grid, refined by golden section.
    fn minimum(
        &self,
        f: impl Fn(f64) -> Result<f64, DecompositionError>,
    ) -> Result<(f64, f64), DecompositionError> {
        let grid = self.grid();
        let values: Vec<f64> = grid.iter().map(|&w| f(w)).collect::<Result<_, _>>()?;
        let Some(k) = (0..values.len()).min_by(|&i, &j| values[i].total_cmp(&values[j])) else {
            return Ok((0.0, f64::NAN));
        };
        let (low, high) = (grid[k.saturating_sub(1)], grid[(k + 1).min(grid.len() - 1)]);
        let middle = golden(low, high, 40, &f)?;
        let value = f(middle)?;
        Ok(if value < values[k] { (middle, value) } else { (grid[k], values[k]) })
    }
}

/// Upper bound of the structured singular value for diagonal complex uncertainty: the largest singular value of
/// `D m D^-1` over positive diagonal D, by cyclic golden section in log D, which is convex. It is exact for up to
/// three inputs (Packard and Doyle, Automatica 29, 1993).
fn structured_singular_value(mut m: DMatrix<C64>) -> Result<f64, DecompositionError> {
    let size = m.nrows();
    let scaled = |m: &DMatrix<C64>, i: usize, log: f64| {
        let mut m = m.clone();
        let factor = C64::new(log.exp(), 0.0);
        m.row_mut(i).iter_mut().for_each(|v| *v *= factor);
        m.column_mut(i).iter_mut().for_each(|v| *v /= factor);
        m
    };
    let mut best = singular_values(&m)?.max();
    for _ in 0..20 {
        let before = best;
        // One scale of D can be chosen freely.
        for i in 1..size {
            let value = |log: f64| Ok(singular_values(&scaled(&m, i, log))?.max());
            let log = golden(-7.0, 7.0, 40, &value)?;
            let least = value(log)?;
            if least < best {
                best = least;
                m = scaled(&m, i, log);
            }
        }
        if best > before * (1.0 - 1e-6) {
            break;
        }
    }
    Ok(best)
}

/// Location of the minimum of a unimodal function, by golden section.
fn golden(
    mut low: f64,
    mut high: f64,
    steps: usize,
    f: &impl Fn(f64) -> Result<f64, DecompositionError>,
) -> Result<f64, DecompositionError> {
    let ratio = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..steps {
        let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
        if f(left)? < f(right)? { high = right } else { low = left }
    }
    Ok(0.5 * (low + high))
}
