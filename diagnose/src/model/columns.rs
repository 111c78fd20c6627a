//! Inner products and sums of columns as long as a record, several at a time.

use multiversion::multiversion;
use nalgebra::DMatrix;
use std::ops::Range;
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
fn blocks(rows: usize) -> impl Iterator<Item = Range<usize>> {
    (0..rows).step_by(BLOCK_ROWS).map(move |from| from..(from + BLOCK_ROWS).min(rows))
}

/// Columns as long as a record, with the rows of each block outside which it is zero: those of an initial state are zero
/// outside its part of the record, and in the channels that it does not affect.
#[derive(Debug, Clone, Default)]
pub struct Sparse {
    columns: Vec<Vec<f64>>,
    filled: Vec<Vec<Range<usize>>>,
}

impl Sparse {
    /// The given columns, all of one length.
    pub fn new(columns: Vec<Vec<f64>>) -> Self {
        let filled = columns.iter().map(|column| filled(column)).collect();
        Self { columns, filled }
    }

    /// Adds a column.
    pub fn push(&mut self, column: Vec<f64>) {
        self.filled.push(filled(&column));
        self.columns.push(column);
    }

    /// The columns.
    pub fn columns(&self) -> &[Vec<f64>] {
        &self.columns
    }

    /// Inner products of the columns with another.
    pub fn dots(&self, with: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; self.columns.len()];
        // A sensor's effect changes one channel of many.
        for (block, rows) in filled(with).into_iter().enumerate().filter(|(_, rows)| !rows.is_empty()) {
            for (i, column, own) in self.within(block) {
                sums[i] += dot_of((column, own), (with, &rows));
            }
        }
        sums
    }

    /// Inner products with each other (Gram matrix).
    pub fn products(&self) -> DMatrix<f64> {
        let n = self.columns.len();
        let mut products = DMatrix::zeros(n, n);
        for block in 0..self.blocks() {
            let here: Vec<_> = self.within(block).collect();
            for (at, (i, a, rows)) in here.iter().enumerate() {
                here[..=at].iter().for_each(|(j, b, other)| {
                    products[(*i, *j)] += dot_of((a, rows), (b, other));
                });
            }
        }
        products.fill_upper_triangle_with_lower_triangle();
        products
    }

    /// Inner products with other columns: one row for each of these here, one column for each of those.
    pub fn products_with(&self, others: &Self) -> DMatrix<f64> {
        let mut products = DMatrix::zeros(self.columns.len(), others.columns.len());
        for block in 0..self.blocks() {
            for (i, a, rows) in self.within(block) {
                others.within(block).for_each(|(j, b, other)| {
                    products[(i, j)] += dot_of((a, rows), (b, other));
                });
            }
        }
        products
    }

    /// Subtracts the columns from another, each times its own factor.
    pub fn subtract_from(&self, from: &mut [f64], by: &[f64]) {
        for block in 0..self.blocks() {
            for (i, column, rows) in self.within(block) {
                subtract(&mut from[rows.clone()], by[i], &column[rows.clone()]);
            }
        }
    }

    fn blocks(&self) -> usize {
        self.filled.first().map_or(0, Vec::len)
    }

    /// The columns that are other than zero in a block, with their indices and their rows there.
    fn within(&self, block: usize) -> impl Iterator<Item = (usize, &[f64], &Range<usize>)> {
        let all = self.columns.iter().zip(&self.filled).enumerate();
        all.map(move |(i, (column, filled))| (i, &column[..], &filled[block])).filter(|own| !own.2.is_empty())
    }
}

/// For each block of a column the rows outside which it is zero there, in whole groups of independent sums: a product over
/// them is that over the block to the last bit.
fn filled(column: &[f64]) -> Vec<Range<usize>> {
    let of_block = |rows: Range<usize>| {
        let values = &column[rows.clone()];
        let Some(first) = values.iter().position(|v| *v != 0.0) else { return rows.start..rows.start };
        let last = values.iter().rposition(|v| *v != 0.0).unwrap_or(first);
        let end = (last + 1).next_multiple_of(SUMS).min(values.len());
        rows.start + first / SUMS * SUMS..rows.start + end
    };
    blocks(column.len()).map(of_block).collect()
}

/// Inner product of two columns over the rows of a block in which both are other than zero.
fn dot_of((a, rows): (&[f64], &Range<usize>), (b, other): (&[f64], &Range<usize>)) -> f64 {
    let both = rows.start.max(other.start)..rows.end.min(other.end);
    if both.is_empty() { 0.0 } else { dot(&a[both.clone()], &b[both]) }
}

/// Subtracts several columns from another, each times its own factor.
pub fn subtract_all(from: &mut [f64], by: &[f64], columns: &[Column]) {
    for rows in blocks(from.len()) {
        for (by, column) in by.iter().zip(columns) {
            subtract(&mut from[rows.clone()], *by, &column[rows.clone()]);
        }
    }
}

/// a - c b, in place.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn subtract(a: &mut [f64], c: f64, b: &[f64]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a -= c * b);
}

/// Number of independent sums of an inner product.
const SUMS: usize = 16;

/// Sum of products, in [`SUMS`] independent sums.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; SUMS];
    let ((a16, a_rest), (b16, b_rest)) = (a.as_chunks::<SUMS>(), b.as_chunks::<SUMS>());
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(x, y)| x * y).sum();
    for (x, y) in a16.iter().zip(b16) {
        for i in 0..SUMS {
            sums[i] += x[i] * y[i];
        }
    }
    rest + sums.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_with_zeros_have_the_products_of_any() {
        let rows = 3 * BLOCK_ROWS + 77;
        let value = |c: usize, k: usize| {
            let within = c == 2 || (c * 4000..c * 4000 + 900).contains(&k) || c == 1 && k > rows - 50;
            if within { ((k * (c + 3)) as f64).sin() } else { 0.0 }
        };
        let columns: Vec<Vec<f64>> = (0..4).map(|c| (0..rows).map(|k| value(c, k)).collect()).collect();
        let with: Vec<f64> = (0..rows).map(|k| (0.1 * k as f64).cos()).collect();
        let mut sparse = Sparse::new(columns[..2].to_vec());
        columns[2..].iter().for_each(|column| sparse.push(column.clone()));
        let plain = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (products, both) = (sparse.products(), sparse.products_with(&sparse));
        for (i, a) in columns.iter().enumerate() {
            assert!((sparse.dots(&with)[i] - plain(a, &with)).abs() < 1e-9);
            for (j, b) in columns.iter().enumerate() {
                assert!((products[(i, j)] - plain(a, b)).abs() < 1e-8 && products[(i, j)] == both[(i, j)]);
            }
        }
        let by = [1.0, -2.0, 0.5, 3.0];
        let mut less = with.clone();
        sparse.subtract_from(&mut less, &by);
        for k in 0..rows {
            let all: f64 = columns.iter().zip(by).map(|(column, by)| by * column[k]).sum();
            assert!((less[k] - with[k] + all).abs() < 1e-12);
        }
    }
}
