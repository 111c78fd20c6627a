//! Comparison of two predictions of the same values (Diebold and Mariano, J. Bus. Econ. Stat. 13, 1995).

/// Share by which what is known of the inputs must reduce the mean square error.
const EXPLAINED_SHARE: f64 = 0.05;

/// Comparison of two predictions of the same values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Mean square error of the first prediction.
    pub first: f64,
    /// Mean square error of the second prediction.
    pub second: f64,
    /// Excess error of the first prediction in standard errors: of (a^2 - b^2) / (a^2 + b^2 + m) with the
    /// mean square m of the first, which neither a few violent manoeuvres nor the noise of quiet flight
    /// dominates.
    pub sigmas: f64,
    /// Excess of the first prediction's square error beyond the share that [`takes_away`] asks for, in standard errors
    /// that account for its correlation. Where an input acts in motion, but a linear model of it errs a little at rest
    /// (friction, a thrust that is no straight line), rest outweighs motion in `sigmas`, not here; few manoeuvres weigh
    /// little, as their own scatter is the standard error; and an input that only reacts, which is a longer memory of the
    /// output, takes little away.
    pub square_sigmas: f64,
}

impl Comparison {
    /// The larger excess.
    pub fn most_sigmas(&self) -> f64 {
        self.sigmas.max(self.square_sigmas)
    }
}

/// Mean of a stationary sequence in standard errors (Newey and West, Econometrica 55, 1987, with lags up to the cube root of
/// the length).
fn mean_in_standard_errors(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let level = values.iter().sum::<f64>() / n;
    let covariance = |lag: usize| {
        values.iter().zip(&values[lag..]).map(|(a, b)| (a - level) * (b - level)).sum::<f64>() / n
    };
    let lags = n.cbrt().ceil() as usize;
    let weighted = (1..=lags).map(|lag| 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * covariance(lag));
    let variance = covariance(0) + weighted.sum::<f64>();
    if variance > 0.0 { level / (variance / n).sqrt() } else { 0.0 }
}

/// Compares the errors of two predictions; neighbouring horizons overlap by half.
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
    // Half of the errors are independent.
    let error = (variance / (0.5 * n)).sqrt();
    let sigmas = if error > 0.0 { score / error } else { 0.0 };
    let excess: Vec<f64> = squares.iter().map(|(a, b)| (1.0 - EXPLAINED_SHARE) * a - b).collect();
    let square_sigmas = mean_in_standard_errors(&excess);
    Some(Comparison { first: mean(|(a, _)| *a), second: mean(|(_, b)| *b), sigmas, square_sigmas })
}

/// True when the second prediction reduces the mean square error of the first enough.
pub fn takes_away(comparison: &Comparison) -> bool {
    comparison.second < (1.0 - EXPLAINED_SHARE) * comparison.first
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    /// A model of the input that errs a little at rest, for most of the time, but is far better in motion.
    #[test]
    fn motion_counts_where_there_is_more_rest_and_a_single_manoeuvre_does_not() {
        let scatter = noise(3000, 7);
        let errors = |moves: fn(usize) -> bool, rest: f64, motion: f64| -> Vec<f64> {
            (0..3000).map(|k| scatter[k] * if moves(k) { motion } else { rest }).collect()
        };
        let often = |k: usize| k % 300 < 30;
        let found = compare(&errors(often, 0.10, 1.0), &errors(often, 0.15, 0.5)).unwrap();
        assert!(found.sigmas < 0.0 && found.square_sigmas > 3.0, "{found:?}");
        let once = |k: usize| (100..130).contains(&k);
        let found = compare(&errors(once, 0.10, 3.0), &errors(once, 0.15, 0.5)).unwrap();
        assert!(found.second < found.first && found.most_sigmas() < 2.0, "{found:?}");
    }
}
