//! A stationary autoregressive noise process of order 4 with exact predictors from the first sample on.

use std::f64::consts::TAU;

use super::random::RandomStream;

/// Order of the process.
const ORDER: usize = 4;

/// The best predictors of a process of variance 1 from its last 0, 1, 2, 3 and 4 values.
pub(crate) struct Autoregression {
    /// Coefficients of each predictor, the youngest value first.
    predictors: [[f64; ORDER]; ORDER + 1],
    /// Prediction error variance of each predictor.
    variances: [f64; ORDER + 1],
}

impl Autoregression {
    /// The process with two pairs of poles, given by their angles (in turns per sample) and their radii,
    /// below 1.
    ///
    /// The Durbin-Levinson recursion is run downwards, from the coefficients of the process to its partial
    /// autocorrelations.
    pub fn of_poles(turns: [f64; 2], radii: [f64; 2]) -> Self {
        let pair = |turns: f64, radius: f64| (2.0 * radius * (TAU * turns).cos(), -radius * radius);
        let ((p1, q1), (p2, q2)) = (pair(turns[0], radii[0]), pair(turns[1], radii[1]));
        let mut predictors = [[0.0; ORDER]; ORDER + 1];
        predictors[ORDER] = [p1 + p2, q1 + q2 - p1 * p2, -(p1 * q2 + p2 * q1), -q1 * q2];
        let mut partial = [0.0; ORDER];
        for order in (1..=ORDER).rev() {
            let k = predictors[order][order - 1];
            partial[order - 1] = k;
            for i in 0..order - 1 {
                predictors[order - 1][i] =
                    (predictors[order][i] + k * predictors[order][order - 2 - i]) / (1.0 - k * k);
            }
        }
        let mut variances = [1.0; ORDER + 1];
        for order in 1..=ORDER {
            variances[order] = variances[order - 1] * (1.0 - partial[order - 1].powi(2));
        }
        Self { predictors, variances }
    }

    /// Prediction of sample `k`, and the standard deviation of its innovation; `past` holds the latest value
    /// first.
    fn predict(&self, k: usize, past: &[f64; ORDER]) -> (f64, f64) {
        let order = k.min(ORDER);
        let expected = self.predictors[order].iter().zip(past).map(|(a, x)| a * x).sum();
        (expected, self.variances[order].sqrt())
    }

    /// Draws noise of standard deviation 1.
    pub fn noise(&self, samples: usize, stream: &mut RandomStream) -> Vec<f64> {
        let mut past = [0.0; ORDER];
        let mut next = |k: usize| {
            let (expected, std) = self.predict(k, &past);
            let x = expected + std * stream.normal();
            past = [x, past[0], past[1], past[2]];
            x
        };
        (0..samples).map(&mut next).collect()
    }

    /// Replaces each value of a noise signal of standard deviation `std` by its innovation divided by the
    /// innovation's standard deviation.
    pub fn whiten<'a>(&self, signal: impl Iterator<Item = &'a mut f64>, std: f64) {
        let mut past = [0.0; ORDER];
        for (k, x) in signal.enumerate() {
            let now = *x / std;
            let (expected, own) = self.predict(k, &past);
            *x = (now - expected) / own;
            past = [now, past[0], past[1], past[2]];
        }
    }
}
