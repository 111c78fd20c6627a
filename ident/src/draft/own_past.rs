//! Whether inputs explain an output better than its own past does: a regression on both against one on the past alone.
//!
//! Both are fitted one step ahead, where the input of a closed loop cannot know what it reacts to (Granger,
//! Econometrica 37, 1969; Ljung, System Identification, 2nd ed., section 13.4), and compared at a horizon on data that were
//! held out (Diebold and Mariano, J. Bus. Econ. Stat. 13, 1995).

use nalgebra::{DMatrix, DVector};

use crate::identify::Segment;

/// Time of the past that a regression looks back, s, and the fewest and most steps for it.
const PAST_S: f64 = 0.1;
const LEAST_LAGS: usize = 12;
const MOST_LAGS: usize = 24;

/// What is added to the diagonal of the normal equations, as a share of it: columns of a smooth signal are nearly the same.
const RIDGE: f64 = 1e-8;

/// Steps that a regression looks back.
pub fn lags(period_s: f64) -> usize {
    ((PAST_S / period_s).ceil() as usize).clamp(LEAST_LAGS, MOST_LAGS)
}

/// y_k from y_(k-1) to y_(k-n), and u_(k-1) to u_(k-m).
#[derive(Debug, Clone)]
pub struct Regression {
    outputs: Vec<f64>,
    inputs: Vec<f64>,
}

impl Regression {
    /// Fits one step ahead by least squares; `None` where the data do not suffice.
    pub fn fit(segments: &[Segment], outputs: usize, inputs: usize) -> Option<Self> {
        let n = outputs + inputs;
        let (mut information, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let mut row = DVector::zeros(n);
        let past = outputs.max(inputs);
        for s in segments {
            for k in past..s.steps {
                (0..outputs).for_each(|i| row[i] = s.outputs[k - 1 - i]);
                (0..inputs).for_each(|i| row[outputs + i] = s.inputs[k - 1 - i]);
                let y = s.outputs[k];
                if y.is_finite() && row.iter().all(|v| v.is_finite()) {
                    information.ger(1.0, &row, &row, 1.0);
                    right.axpy(y, &row, 1.0);
                }
            }
        }
        for i in 0..n {
            // A signal that does not move has a coefficient of zero.
            let own = information[(i, i)];
            information[(i, i)] += (RIDGE * own).max(f64::MIN_POSITIVE.sqrt());
        }
        let found = information.cholesky()?.solve(&right);
        let coefficients: Vec<f64> = found.iter().copied().collect();
        let (outputs, inputs) = coefficients.split_at(outputs);
        Some(Self { outputs: outputs.to_vec(), inputs: inputs.to_vec() })
    }

    /// Errors of predictions `horizon` steps ahead, one from each of `starts`, which are the last steps that are known;
    /// NaN where a value is missing.
    pub fn errors(&self, s: &Segment, starts: &[usize], horizon: usize) -> Vec<f64> {
        let n = self.outputs.len();
        let one = |&k: &usize| {
            if k + 1 < n.max(self.inputs.len()) || k + horizon >= s.steps {
                return f64::NAN;
            }
            // Newest first, as the coefficients are.
            let mut past: Vec<f64> = (0..n).map(|i| s.outputs[k - i]).collect();
            for j in 1..=horizon {
                let from_past: f64 = self.outputs.iter().zip(&past).map(|(a, y)| a * y).sum();
                let from_inputs = self.inputs.iter().enumerate().map(|(i, b)| b * s.inputs[k + j - 1 - i]);
                let next = from_past + from_inputs.sum::<f64>();
                past.rotate_right(1);
                past[0] = next;
            }
            s.outputs[k + horizon] - past[0]
        };
        starts.iter().map(one).collect()
    }
}

/// Steps of a segment from which predictions start, two a horizon, after `warm` steps in which a filter settles.
pub fn starts(segment: &Segment, warm: usize, horizon: usize) -> Vec<usize> {
    (warm..segment.steps.saturating_sub(horizon)).step_by((horizon / 2).max(1)).collect()
}

/// How two predictions of the same values compare.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Mean square error of the first.
    pub first: f64,
    /// Mean square error of the second.
    pub second: f64,
    /// By how many standard errors the first errs more: of (a^2 - b^2) / (a^2 + b^2 + m) with the mean square m of the first,
    /// which neither a few violent manoeuvres nor the noise of quiet flight can rule.
    pub sigmas: f64,
}

/// Compares the errors of two predictions, of which neighbours overlap by half.
pub fn compare(first: &[f64], second: &[f64]) -> Option<Comparison> {
    let both = first.iter().zip(second).filter(|(a, b)| a.is_finite() && b.is_finite());
    let squares: Vec<(f64, f64)> = both.map(|(a, b)| (a * a, b * b)).collect();
    let n = squares.len() as f64;
    if n < 8.0 {
        return None;
    }
    let mean = |of: fn(&(f64, f64)) -> f64| squares.iter().map(of).sum::<f64>() / n;
    let usual = mean(|(a, _)| *a).max(f64::MIN_POSITIVE);
    let scores: Vec<f64> = squares.iter().map(|(a, b)| (a - b) / (a + b + usual)).collect();
    let score = scores.iter().sum::<f64>() / n;
    let variance = scores.iter().map(|s| (s - score).powi(2)).sum::<f64>() / (n - 1.0);
    // Half of them are independent.
    let error = (variance / (0.5 * n)).sqrt();
    let sigmas = if error > 0.0 { score / error } else { 0.0 };
    Some(Comparison { first: mean(|(a, _)| *a), second: mean(|(_, b)| *b), sigmas })
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_logs::testing::noise;

    /// A first-order motion driven by an input and by noise, or by noise alone.
    fn flight(gain: f64, seed: u64) -> Segment {
        let steps = 3000;
        let (e, v) = (noise(steps, seed), noise(steps, seed + 1));
        let (mut y, mut u) = (0.0, 0.0);
        let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
        for k in 0..steps {
            outputs.push(y);
            // The input reacts to the output, as that of a closed loop.
            u = 0.9 * u + 0.3 * v[k] - 0.1 * y;
            inputs.push(u);
            y = 0.95 * y + gain * u + 0.05 * e[k];
        }
        Segment { origin: "x".into(), start_s: 0.0, period_s: 0.01, inputs, outputs, steps }
    }

    fn compared(gain: f64) -> Comparison {
        let (fitted, held) = ([flight(gain, 1)], flight(gain, 5));
        let own = Regression::fit(&fitted, 12, 0).unwrap();
        let with = Regression::fit(&fitted, 12, 12).unwrap();
        let starts = starts(&held, 24, 10);
        compare(&own.errors(&held, &starts, 10), &with.errors(&held, &starts, 10)).unwrap()
    }

    #[test]
    fn an_input_that_acts_is_told_from_one_that_only_reacts() {
        let acts = compared(0.1);
        assert!(acts.sigmas > 5.0 && acts.second < 0.5 * acts.first, "{acts:?}");
        let reacts = compared(0.0);
        assert!(reacts.sigmas < 3.0, "{reacts:?}");
    }
}
