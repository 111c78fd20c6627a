//! Inner products and sums of columns as long as a record, several at a time.

use multiversion::multiversion;
use nalgebra::DMatrix;
use std::sync::Arc;

/// Sensitivities of all samples to one parameter. Those to the initial state are shared by many fits.
pub type Column = Arc<Vec<f64>>;

/// Range of a parameter, and a typical change of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slot {
    /// Lower limit.
    pub lower: f64,
    /// Upper limit.
    pub upper: f64,
    /// Typical change, used as the step of finite differences.
    pub scale: f64,
}

/// Rows per block, so that a dozen columns (32 kB each) stay in the cache: several columns are processed
/// block by block, and each is loaded once.
const BLOCK_ROWS: usize = 4096;

/// Row ranges of the blocks.
pub(crate) fn blocks(rows: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    (0..rows).step_by(BLOCK_ROWS).map(move |from| from..(from + BLOCK_ROWS).min(rows))
}

/// Inner products of several columns with another.
pub fn dots<C: std::borrow::Borrow<Vec<f64>>>(columns: &[C], with: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; columns.len()];
    for rows in blocks(with.len()) {
        for (sum, column) in sums.iter_mut().zip(columns) {
            *sum += dot(&column.borrow()[rows.clone()], &with[rows.clone()]);
        }
    }
    sums
}

/// Subtracts several columns from another, each times its own factor.
pub fn subtract_all<C: std::borrow::Borrow<Vec<f64>>>(from: &mut [f64], by: &[f64], columns: &[C]) {
    for rows in blocks(from.len()) {
        for (by, column) in by.iter().zip(columns) {
            subtract(&mut from[rows.clone()], *by, &column.borrow()[rows.clone()]);
        }
    }
}

/// a - c b, in place.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn subtract(a: &mut [f64], c: f64, b: &[f64]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a -= c * b);
}

/// Sum of products, in sixteen independent sums.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 16];
    let ((a16, a_rest), (b16, b_rest)) = (a.as_chunks::<16>(), b.as_chunks::<16>());
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    for (x, y) in a16.iter().zip(b16) {
        for i in 0..16 {
            sums[i] += x[i] * y[i];
        }
    }
    rest + sums.iter().sum::<f64>()
}

/// Inner products of all columns with each other (Gram matrix).
pub(crate) fn products(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let n = columns.len();
    let mut products = DMatrix::zeros(n, n);
    for rows in blocks(columns.first().map_or(0, Vec::len)) {
        for i in 0..n {
            for j in 0..=i {
                products[(i, j)] += dot(&columns[i][rows.clone()], &columns[j][rows.clone()]);
            }
        }
    }
    products.fill_upper_triangle_with_lower_triangle();
    products
}
