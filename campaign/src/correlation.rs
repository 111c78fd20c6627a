//! Which of the things that varied moved a figure.

/// Spearman's rank correlation of two rows of numbers of the same length, ties at their mean rank (Spearman 1904; Saltelli and
/// others, "Global Sensitivity Analysis", Wiley 2008, section 1.2.2, for its use as a measure of sensitivity): -1 to 1, and `None` where
/// fewer than three pairs are finite, or one of the two does not vary.
pub fn rank_correlation(x: &[f64], y: &[f64]) -> Option<f64> {
    let pairs: Vec<(f64, f64)> =
        x.iter().copied().zip(y.iter().copied()).filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    if pairs.len() < 3 {
        return None;
    }
    let (rx, ry) = (ranks(pairs.iter().map(|p| p.0)), ranks(pairs.iter().map(|p| p.1)));
    let mean = (pairs.len() as f64 - 1.0) / 2.0;
    let sum =
        |f: &dyn Fn(f64, f64) -> f64| rx.iter().zip(&ry).map(|(x, y)| f(x - mean, y - mean)).sum::<f64>();
    let (xy, xx, yy) = (sum(&|x, y| x * y), sum(&|x, _| x * x), sum(&|_, y| y * y));
    (xx > 0.0 && yy > 0.0).then(|| xy / (xx * yy).sqrt())
}

/// Ranks from 0, the mean of their places for equal values.
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let values: Vec<f64> = values.collect();
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let equal = order[first..].iter().take_while(|&&i| values[i] == values[order[first]]).count().max(1);
        let rank = first as f64 + (equal as f64 - 1.0) / 2.0;
        order[first..first + equal].iter().for_each(|&i| ranks[i] = rank);
        first += equal;
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_grows_with_it_has_one_whatever_the_curve() {
        let x: Vec<f64> = (0..20).map(f64::from).collect();
        let cubed: Vec<f64> = x.iter().map(|x| -x.powi(3)).collect();
        assert_eq!(rank_correlation(&x, &cubed), Some(-1.0));
        assert_eq!(rank_correlation(&x, &[1.0; 20]), None);
    }

    /// `scipy.stats.spearmanr`, SciPy 1.17, with ties.
    #[test]
    fn ties_have_their_mean_rank() {
        let (x, y) = ([1.0, 2.0, 2.0, 3.0, 5.0, 4.0], [2.0, 1.0, 4.0, 4.0, 9.0, 7.0]);
        let found = rank_correlation(&x, &y).unwrap();
        assert!((found - 0.867_647_058_823_529_4).abs() < 1e-12, "{found}");
        assert_eq!(rank_correlation(&[1.0, f64::NAN, 2.0], &[1.0, 2.0, 3.0]), None);
    }
}
