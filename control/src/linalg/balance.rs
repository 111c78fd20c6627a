//! Balancing: powers of two that make rows and columns of a matrix alike in size.

use nalgebra::DMatrix;

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
            let step = (0.5 * (row / column).log2()).round() as i32;
            if step == 0 {
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
