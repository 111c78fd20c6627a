//! White noise on a zero that wanders: angle random walk beside bias instability, the usual noise of a gyroscope (IEEE Std
//! 952), and in general a local level (Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989).
//!
//! Beside white noise a wander of the same size hardly shows from sample to sample, but holds most of the power at low
//! frequencies. An autoregressive model of free coefficients needs many of them for it, each at the price of a parameter;
//! this one has two, the wander's size and its time constant. Its innovations are those of a Kalman filter, exact from the
//! first sample on: any model of finite memory takes the slowest part of the wander for an offset, a drift or a step.

use std::f64::consts::TAU;
use std::sync::LazyLock;

use multiversion::multiversion;

use crate::thresholds::{MAX_AR_ORDER, WANDER_RATIOS, WANDER_START_STEPS, WANDER_TIMES};

/// Sizes and time constants that are compared.
const MEMBERS: usize = WANDER_TIMES.len() * WANDER_RATIOS.len();

/// A value for each of these.
type Each = [f64; MEMBERS];

/// Kalman filters of all sizes and time constants, for white noise of variance 1.
struct Bank {
    /// Share of the zero that is left after a step.
    decay: Each,
    /// Variance of the wander.
    ratio: Each,
    /// Gain of each of the first steps; the last holds from then on.
    gain: Vec<Each>,
    /// Variance of the settled innovation over that of each of the first steps.
    certainty: Vec<Each>,
    /// Variance of the settled innovation.
    settled: Each,
    /// Logarithm of the determinant of the innovations that a likelihood counts, beyond settled ones.
    log_det: Each,
}

static BANK: LazyLock<Bank> = LazyLock::new(Bank::new);

impl Bank {
    fn new() -> Self {
        let (mut decay, mut ratio) = ([0.0; MEMBERS], [0.0; MEMBERS]);
        let all = WANDER_TIMES.iter().flat_map(|time| WANDER_RATIOS.iter().map(move |ratio| (time, ratio)));
        for (i, (time, size)) in all.enumerate() {
            (decay[i], ratio[i]) = ((-1.0 / time).exp(), *size);
        }
        // Before the first sample, the zero may be anywhere within its wander.
        let mut unknown = ratio;
        let (mut gain, mut variance) = (Vec::new(), Vec::new());
        for _ in 0..WANDER_START_STEPS {
            let innovation = unknown.map(|p| p + 1.0);
            gain.push(std::array::from_fn(|i| unknown[i] / innovation[i]));
            variance.push(innovation);
            unknown = std::array::from_fn(|i| {
                let kept = decay[i] * decay[i];
                kept * unknown[i] / innovation[i] + ratio[i] * (1.0 - kept)
            });
        }
        let settled: Each = variance[WANDER_START_STEPS - 1];
        let certainty: Vec<Each> =
            variance.iter().map(|of: &Each| std::array::from_fn(|i| settled[i] / of[i])).collect();
        let mut log_det = [0.0; MEMBERS];
        for of in &certainty[MAX_AR_ORDER..] {
            log_det.iter_mut().zip(of).for_each(|(sum, certainty)| *sum -= certainty.ln());
        }
        Self { decay, ratio, gain, certainty, settled, log_det }
    }

    /// As `log_det`, of a run of so many values.
    fn log_det_of(&self, member: usize, values: usize) -> f64 {
        if values >= WANDER_START_STEPS {
            return self.log_det[member];
        }
        self.certainty[..values].iter().skip(MAX_AR_ORDER).map(|of| -of[member].ln()).sum()
    }
}

/// Noise of a sensor whose zero wanders.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wander {
    /// Index of size and time constant.
    member: usize,
    /// Variance of the settled innovation.
    pub variance: f64,
}

impl Wander {
    /// Free parameters besides the variance.
    pub const PARAMETERS: usize = 2;

    /// The size and time constant that make a residual most likely, by the rows that every noise model is judged by.
    pub fn fit(runs: &[&[f64]]) -> Option<Self> {
        // As many values as free coefficients of the highest order need.
        if runs.iter().map(|run| run.len()).sum::<usize>() < 10 * MAX_AR_ORDER {
            return None;
        }
        let rows: usize = runs.iter().map(|run| run.len().saturating_sub(MAX_AR_ORDER)).sum();
        let rows = rows as f64;
        let (mut all, mut log_det) = ([0.0; MEMBERS], [0.0; MEMBERS]);
        for run in runs {
            all.iter_mut().zip(squares(&BANK, run)).for_each(|(sum, own)| *sum += own);
            log_det
                .iter_mut()
                .enumerate()
                .for_each(|(member, sum)| *sum += BANK.log_det_of(member, run.len()));
        }
        let squares = all;
        let cost = |i: &usize| rows * squares[*i].ln() + log_det[*i];
        let member = (0..MEMBERS).min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        let variance = squares[member] / rows;
        (variance > 0.0).then_some(Self { member, variance })
    }

    /// The same spectrum with another variance of the innovation.
    pub fn with_variance(self, variance: f64) -> Self {
        Self { variance, ..self }
    }

    /// Logarithm of the determinant of the first innovations that a likelihood counts of a run of so many values, beyond
    /// settled ones.
    pub fn log_det(&self, values: usize) -> f64 {
        BANK.log_det_of(self.member, values)
    }

    /// Innovations of a run of residuals, scaled to the variance of settled ones.
    pub fn filter(&self, run: &[f64], out: &mut [f64]) {
        let (i, bank) = (self.member, &*BANK);
        let mut zero = 0.0;
        let first = run.len().min(WANDER_START_STEPS);
        for k in 0..first {
            let off = run[k] - zero;
            out[k] = off * bank.certainty[k][i].sqrt();
            zero = bank.decay[i] * (zero + bank.gain[k][i] * off);
        }
        self.filter_on(zero, &run[first..], &mut out[first..]);
    }

    /// Innovations of the settled filter, as if the zero had been known long before: the same at any time.
    pub fn filter_settled(&self, run: &[f64], out: &mut [f64]) {
        self.filter_on(0.0, run, out);
    }

    fn filter_on(&self, mut zero: f64, run: &[f64], out: &mut [f64]) {
        let (decay, gain) = (BANK.decay[self.member], BANK.gain[WANDER_START_STEPS - 1][self.member]);
        let (keep, take) = (decay * (1.0 - gain), decay * gain);
        for (out, r) in out.iter_mut().zip(run) {
            *out = r - zero;
            zero = keep * zero + take * r;
        }
    }

    /// Spectral density, one-sided, at a frequency in Hz.
    pub fn density(&self, f: f64, period_s: f64) -> f64 {
        let (decay, ratio) = (BANK.decay[self.member], BANK.ratio[self.member]);
        let white = self.variance / BANK.settled[self.member];
        let open = 1.0 - 2.0 * decay * (TAU * f * period_s).cos() + decay * decay;
        2.0 * period_s * white * (1.0 + ratio * (1.0 - decay * decay) / open)
    }
}

/// Sums of the squared innovations of all filters over the rows that count, each scaled to a settled one.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn squares(bank: &Bank, run: &[f64]) -> Each {
    let (mut zero, mut sum) = ([0.0; MEMBERS], [0.0; MEMBERS]);
    let first = run.len().min(WANDER_START_STEPS);
    for (k, r) in run[..first].iter().enumerate() {
        let (gain, certainty) = (&bank.gain[k], &bank.certainty[k]);
        let counts = if k < MAX_AR_ORDER { 0.0 } else { 1.0 };
        for i in 0..MEMBERS {
            let off = r - zero[i];
            sum[i] += counts * off * off * certainty[i];
            zero[i] = bank.decay[i] * (zero[i] + gain[i] * off);
        }
    }
    let gain = &bank.gain[WANDER_START_STEPS - 1];
    for r in &run[first..] {
        for i in 0..MEMBERS {
            let off = r - zero[i];
            sum[i] += off * off;
            zero[i] = bank.decay[i] * (zero[i] + gain[i] * off);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::channel_noise::tests::noise;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn innovations_are_those_of_the_covariance_of_the_whole_run() {
        let run = noise(3, 1.0, 250.0, 60);
        for member in [0, MEMBERS / 2, MEMBERS - 1] {
            let wander = Wander { member, variance: 1.0 };
            let (decay, ratio) = (BANK.decay[member], BANK.ratio[member]);
            let covariance = DMatrix::from_fn(run.len(), run.len(), |i, j| {
                ratio * decay.powi(i.abs_diff(j) as i32) + if i == j { 1.0 } else { 0.0 }
            });
            // The Cholesky factor orthogonalises one value after the other.
            let factor = covariance.cholesky().unwrap().l();
            let white = factor.solve_lower_triangular(&DVector::from_vec(run.clone())).unwrap();
            let mut out = vec![0.0; run.len()];
            wander.filter(&run, &mut out);
            for (k, (a, b)) in out.iter().zip(white.iter()).enumerate() {
                let a = a / BANK.settled[member].sqrt();
                assert!((a - b).abs() < 1e-9, "{member} {k}: {a} {b}");
            }
        }
    }

    #[test]
    fn all_filters_at_once_give_the_squares_of_each() {
        let run = noise(3, 1.0, 250.0, WANDER_START_STEPS + 300);
        let squares = squares(&BANK, &run);
        for (member, square) in squares.iter().enumerate() {
            let mut out = vec![0.0; run.len()];
            Wander { member, variance: 1.0 }.filter(&run, &mut out);
            let sum: f64 = out[MAX_AR_ORDER..].iter().map(|e| e * e).sum();
            assert!((sum - square).abs() < 1e-9 * sum, "{member}");
        }
    }
}
