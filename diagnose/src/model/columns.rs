//! Products and sums of columns as long as a record, several of them together.

use multiversion::multiversion;
use nalgebra::DMatrix;
use std::sync::Arc;

/// Sensitivities of all samples by one value. Those by the initial state are the same in many fits.
pub type Column = Arc<Vec<f64>>;

/// Where a value may be, and a typical change of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slot {
    /// Least value.
    pub lower: f64,
    /// Greatest value.
    pub upper: f64,
    /// A typical change, for differences.
    pub scale: f64,
}

/// So many rows of a dozen columns lie near the processor (32 kB each): several columns are taken together block by block,
/// so that each is fetched once.
const BLOCK_ROWS: usize = 4096;

/// The rows, block by block.
pub(crate) fn blocks(rows: usize) -> impl Iterator<Item = std::ops::Range<usize>> {
    (0..rows).step_by(BLOCK_ROWS).map(move |from| from..(from + BLOCK_ROWS).min(rows))
}

/// Products of several columns with another.
pub fn dots<C: std::borrow::Borrow<Vec<f64>>>(columns: &[C], with: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0; columns.len()];
    for rows in blocks(with.len()) {
        for (sum, column) in sums.iter_mut().zip(columns) {
            *sum += dot(&column.borrow()[rows.clone()], &with[rows.clone()]);
        }
    }
    sums
}

/// Takes several columns off another, each by its own factor.
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

/// Products of all columns with each other.
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
