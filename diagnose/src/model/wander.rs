//! White noise on a zero that wanders: angle random walk beside bias instability, the usual noise of a gyroscope (IEEE Std
//! 952), and in general a local level (Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989).
//!
//! Beside white noise a wander of the same size hardly shows from sample to sample, but holds most of the power at low
//! frequencies. An autoregressive model of free coefficients needs many of them for it, each at the price of a parameter;
//! this one has two, the wander's size and its time constant, and is its best prediction from as many values.

use std::sync::LazyLock;

use nalgebra::{DMatrix, DVector};
use whirlstand_ident::identify::ar::Ar;

use crate::model::columns::dot;
use crate::thresholds::{MAX_AR_ORDER, WANDER_RATIOS, WANDER_TIMES};

/// Free parameters of the model besides the variance.
const PARAMETERS: usize = 2;

/// Coefficients of the predictors of all sizes and time constants, from the newest value to the oldest.
static PREDICTORS: LazyLock<Vec<Vec<f64>>> = LazyLock::new(|| {
    WANDER_TIMES
        .iter()
        .flat_map(|time| WANDER_RATIOS.iter().map(|ratio| predictor(*time, *ratio)))
        .flatten()
        .collect()
});

/// The best prediction of white noise of variance 1 beside a Gauss-Markov process of variance `ratio` and time constant
/// `time`, steps, as coefficients of A(q).
fn predictor(time: f64, ratio: f64) -> Option<Vec<f64>> {
    let wander = |lag: usize| ratio * (-(lag as f64) / time).exp();
    let n = MAX_AR_ORDER;
    let covariance = DMatrix::from_fn(n, n, |i, j| wander(i.abs_diff(j)) + if i == j { 1.0 } else { 0.0 });
    let right = DVector::from_fn(n, |i, _| -wander(i + 1));
    Some(covariance.cholesky()?.solve(&right).iter().copied().collect())
}

/// The more likely of `free`, fitted to the residual, and white noise beside a wander, by BIC over the rows that have a past.
pub(super) fn or_wandering(free: Ar, residual: &[f64]) -> Ar {
    let n = MAX_AR_ORDER;
    // An order of a tenth of the values, as free coefficients have.
    if residual.len() < 10 * n {
        return free;
    }
    let products = products(residual);
    let rows = (residual.len() - n) as f64;
    let variance = |coefficients: &[f64]| {
        let a: Vec<f64> = std::iter::once(1.0).chain(coefficients.iter().copied()).collect();
        let square =
            |(i, x): (usize, &f64)| x * a.iter().enumerate().map(|(j, y)| y * products[(i, j)]).sum::<f64>();
        a.iter().enumerate().map(square).sum::<f64>() / rows
    };
    let bic = |variance: f64, parameters: usize| rows * variance.ln() + parameters as f64 * rows.ln();
    let of_free = bic(variance(&free.coefficients), free.parameters);
    let all = PREDICTORS.iter().map(|coefficients| (variance(coefficients), coefficients));
    match all.min_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((variance, coefficients)) if variance > 0.0 && bic(variance, PARAMETERS) < of_free => {
            Ar { coefficients: coefficients.clone(), parameters: PARAMETERS, variance }
        }
        _ => free,
    }
}

/// Sums of products of the values i and j steps before each row that has a past, one row and column for each lag.
fn products(values: &[f64]) -> DMatrix<f64> {
    let (n, len) = (MAX_AR_ORDER, values.len());
    let mut all = DMatrix::zeros(n + 1, n + 1);
    for lag in 0..=n {
        all[(0, lag)] = dot(&values[n..], &values[n - lag..len - lag]);
        // Each further pair gains a product at the beginning and loses one at the end.
        for i in 0..n - lag {
            let j = i + lag;
            all[(i + 1, j + 1)] = all[(i, j)] + values[n - i - 1] * values[n - j - 1]
                - values[len - i - 1] * values[len - j - 1];
        }
    }
    all.fill_lower_triangle_with_upper_triangle();
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    fn noise(wander: f64, steps: usize) -> Vec<f64> {
        let mut stream = Stream::new(3, "wander");
        let mut zero = wander * stream.normal();
        let keep = (-1.0 / 250.0f64).exp();
        (0..steps)
            .map(|_| {
                zero = keep * zero + (1.0 - keep * keep).sqrt() * wander * stream.normal();
                zero + stream.normal()
            })
            .collect()
    }

    #[test]
    fn products_are_the_sums_of_all_rows() {
        let values = noise(1.0, 300);
        let products = products(&values);
        for (i, j) in [(0, 0), (3, 7), (MAX_AR_ORDER, 1), (MAX_AR_ORDER, MAX_AR_ORDER)] {
            let sum: f64 = (MAX_AR_ORDER..values.len()).map(|k| values[k - i] * values[k - j]).sum();
            assert!((products[(i, j)] - sum).abs() < 1e-9 * sum.abs().max(1.0), "{i} {j}");
        }
    }

    /// Power at a frequency, cycles per step, of the model that whitens a residual.
    fn power(ar: &Ar, frequency: f64) -> f64 {
        let (mut re, mut im) = (1.0, 0.0);
        for (lag, a) in (1..).zip(&ar.coefficients) {
            let angle = std::f64::consts::TAU * frequency * f64::from(lag);
            (re, im) = (re + a * angle.cos(), im - a * angle.sin());
        }
        ar.variance / (re * re + im * im)
    }

    #[test]
    fn a_wander_of_the_size_of_the_noise_is_told_and_has_its_power() {
        let values = noise(1.0, 1000);
        let free = Ar::fit(&[&values], MAX_AR_ORDER);
        let found = or_wandering(free.clone(), &values);
        assert_eq!(found.parameters, PARAMETERS, "{found:?}");
        // Free coefficients, each at its price, stop at a few and miss most of the power at rest.
        assert!(power(&found, 0.0) > 2.0 * power(&free, 0.0), "{found:?} {free:?}");
        let white = noise(0.0, 1000);
        let free = Ar::fit(&[&white], MAX_AR_ORDER);
        assert_eq!(or_wandering(free.clone(), &white), free, "nothing wanders");
    }
}
