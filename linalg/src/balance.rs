//! Balancing: scaling by powers of two that gives rows and columns of a matrix similar size.

use nalgebra::DMatrix;

/// Largest exponent, so that the ratio of two such powers of two is finite.
const LARGEST: i32 = 500;

/// Exponents e such that `D^-1 a D` with `D = diag(2^e)` has rows and columns of about equal 1-norm
/// (Parlett and Reinsch, Numer. Math. 13, 1969, without permutation). `a` is n x n; n exponents return.
pub fn balancing_exponents(a: &DMatrix<f64>) -> Vec<i32> {
    let n = a.nrows();
    let mut m = a.clone();
    let mut exponents = vec![0i32; n];
    for _ in 0..100 {
        let mut changed = false;
        for i in 0..n {
            let column: f64 = (0..n).filter(|&k| k != i).map(|k| m[(k, i)].abs()).sum();
            let row: f64 = (0..n).filter(|&k| k != i).map(|k| m[(i, k)].abs()).sum();
            if column == 0.0 || row == 0.0 || !column.is_finite() || !row.is_finite() {
                continue;
            }
            // The quotient may overflow; the cast saturates at the largest integer.
            let step = ((0.5 * (row / column).log2()).round() as i32).clamp(-LARGEST, LARGEST);
            if step == 0 || (exponents[i] + step).abs() > LARGEST {
                continue;
            }
            let scale = f64::powi(2.0, step);
            if (column * scale + row / scale) < 0.95 * (column + row) {
                exponents[i] += step;
                m.column_mut(i).scale_mut(scale);
                m.row_mut(i).scale_mut(1.0 / scale);
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
    exponents
}

/// `D^-1 a D` with `D = diag(2^e)` of [`balancing_exponents`]: the n x n matrix `a`, finite, in the units in which its
/// eigenvalues are less sensitive. No entry loses a digit.
pub fn balance(a: &DMatrix<f64>) -> DMatrix<f64> {
    let e = balancing_exponents(a);
    DMatrix::from_fn(a.nrows(), a.ncols(), |i, j| a[(i, j)] * f64::powi(2.0, e[j] - e[i]))
}
