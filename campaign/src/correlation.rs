//! Rank correlations between varied quantities and figures, and roots of correlation matrices for joint
//! draws.

use nalgebra::DMatrix;

/// The lower root of a correlation matrix (Cholesky). A direction that depends linearly on those before it counts
/// as zero within rounding, so that parameters that depend on others can be drawn. `None` where the matrix is no
/// correlation matrix.
pub fn correlation_root(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    /// Share of a variance by which rounding may leave it above or below zero.
    const ROUNDING: f64 = 1e-12;
    let n = matrix.nrows();
    let mut root = DMatrix::<f64>::zeros(n, n);
    for j in 0..n {
        let left = matrix[(j, j)] - root.row(j).norm_squared();
        if left.is_nan() || left <= -ROUNDING {
            return None;
        }
        let follows = left < ROUNDING;
        root[(j, j)] = if follows { 0.0 } else { left.sqrt() };
        for i in j + 1..n {
            let rest = matrix[(i, j)] - root.row(i).dot(&root.row(j));
            if follows && (rest.is_nan() || rest.abs() >= ROUNDING.sqrt()) {
                return None;
            }
            root[(i, j)] = if follows { 0.0 } else { rest / root[(j, j)] };
        }
    }
    Some(root)
}

/// Spearman's rank correlation of two sequences of numbers of the same length, ties at their mean rank (Spearman
/// 1904; Saltelli and others, "Global Sensitivity Analysis", Wiley 2008, section 1.2.2, for its use as a measure
/// of sensitivity): -1 to 1, and `None` where fewer than three pairs are finite, or one of the two does not vary.
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

/// Ranks from 0; equal values have the mean of their ranks.
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

    #[test]
    fn a_correlation_matrix_has_a_root_though_one_follows_from_another() {
        let of = |r: &[f64]| DMatrix::from_row_slice(3, 3, r);
        for matrix in [
            of(&[1.0, 0.5, -0.2, 0.5, 1.0, 0.3, -0.2, 0.3, 1.0]),
            of(&[1.0, -1.0, 0.4, -1.0, 1.0, -0.4, 0.4, -0.4, 1.0]),
        ] {
            let root = correlation_root(&matrix).unwrap();
            assert!((&root * root.transpose() - &matrix).amax() < 1e-12, "{root}");
            assert!(root.upper_triangle().iter().filter(|v| **v != 0.0).count() <= 3);
        }
        // The first two are identical; the third cannot be correlated with one of them and anticorrelated
        // with the other.
        assert_eq!(correlation_root(&of(&[1.0, 1.0, 0.4, 1.0, 1.0, -0.4, 0.4, -0.4, 1.0])), None);
        assert_eq!(correlation_root(&of(&[1.0, 1.2, 0.0, 1.2, 1.0, 0.0, 0.0, 0.0, 1.0])), None);
        assert_eq!(correlation_root(&of(&[1.0, f64::NAN, 0.0, f64::NAN, 1.0, 0.0, 0.0, 0.0, 1.0])), None);
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
