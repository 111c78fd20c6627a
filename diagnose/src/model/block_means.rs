//! Standard errors of means of correlated values, by blocks (Diebold and Mariano, J. Bus. Econ. Stat. 13, 1995).

use std::collections::BTreeMap;

use crate::thresholds::LEAST_COMPARED_BLOCKS;
use whirlstand_logs::stats::mean;

/// Mean of values over blocks of `block` steps divided by its standard error, and the number of blocks; `None`
/// for too few. A block should be twice as long as the values are correlated.
pub fn mean_in_errors(values: impl Iterator<Item = (usize, f64)>, block: usize) -> Option<(f64, usize)> {
    let mut sums = BTreeMap::<usize, f64>::new();
    for (step, value) in values {
        *sums.entry(step / block.max(1)).or_default() += value;
    }
    let sums: Vec<f64> = sums.into_values().collect();
    if sums.len() < LEAST_COMPARED_BLOCKS {
        return None;
    }
    let middle = mean(&sums);
    let spread: f64 = sums.iter().map(|b| (b - middle).powi(2)).sum();
    let error = (spread / (sums.len() * (sums.len() - 1)) as f64).sqrt();
    (error > 0.0).then(|| (middle / error, sums.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_the_mean_and_its_error() {
        // Sums of two: 1, 3, 1, 3, 1, 3: mean 2, standard deviation 1.095, error 0.447.
        let values = [0.0, 1.0, 1.0, 2.0].into_iter().cycle().take(12).enumerate();
        let (t, count) = mean_in_errors(values, 2).unwrap();
        assert!((t - 2.0 / (0.2f64).sqrt()).abs() < 1e-12 && count == 6, "{t}");
        assert_eq!(mean_in_errors((0..8).map(|k| (k, 1.0)), 2), None, "four blocks");
    }
}
