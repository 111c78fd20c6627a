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

/// Columns as long as a record, with the blocks in which each is other than zero: those of an initial state are zero outside
/// its part of the record, and in the channels that it does not affect.
#[derive(Debug, Clone, Default)]
pub struct Sparse {
    columns: Vec<Vec<f64>>,
    occupied: Vec<Vec<bool>>,
}

impl Sparse {
    /// The given columns, all of one length.
    pub fn new(columns: Vec<Vec<f64>>) -> Self {
        let occupied = columns.iter().map(|column| occupied(column)).collect();
        Self { columns, occupied }
    }

    /// Adds a column.
    pub fn push(&mut self, column: Vec<f64>) {
        self.occupied.push(occupied(&column));
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
        let occupied = occupied(with);
        for (block, rows) in blocks(with.len()).enumerate().filter(|(block, _)| occupied[*block]) {
            for (i, column) in self.filled(block, &rows) {
                sums[i] += dot(column, &with[rows.clone()]);
            }
        }
        sums
    }

    /// Inner products with each other (Gram matrix).
    pub fn products(&self) -> DMatrix<f64> {
        let n = self.columns.len();
        let mut products = DMatrix::zeros(n, n);
        for (block, rows) in blocks(self.rows()).enumerate() {
            let here: Vec<(usize, &[f64])> = self.filled(block, &rows).collect();
            for (at, (i, a)) in here.iter().enumerate() {
                here[..=at].iter().for_each(|(j, b)| products[(*i, *j)] += dot(a, b));
            }
        }
        products.fill_upper_triangle_with_lower_triangle();
        products
    }

    /// Inner products with other columns: one row for each of these here, one column for each of those.
    pub fn products_with(&self, others: &Self) -> DMatrix<f64> {
        let mut products = DMatrix::zeros(self.columns.len(), others.columns.len());
        for (block, rows) in blocks(self.rows()).enumerate() {
            for (i, a) in self.filled(block, &rows) {
                others.filled(block, &rows).for_each(|(j, b)| products[(i, j)] += dot(a, b));
            }
        }
        products
    }

    /// Subtracts the columns from another, each times its own factor.
    pub fn subtract_from(&self, from: &mut [f64], by: &[f64]) {
        for (block, rows) in blocks(from.len()).enumerate() {
            for (i, column) in self.filled(block, &rows) {
                subtract(&mut from[rows.clone()], by[i], column);
            }
        }
    }

    fn rows(&self) -> usize {
        self.columns.first().map_or(0, Vec::len)
    }

    /// The rows of a block of the columns that are other than zero there, with their indices.
    fn filled(&self, block: usize, rows: &Range<usize>) -> impl Iterator<Item = (usize, &[f64])> {
        let rows = rows.clone();
        let all = self.columns.iter().zip(&self.occupied).enumerate();
        all.filter(move |(_, (_, occupied))| occupied[block])
            .map(move |(i, (column, _))| (i, &column[rows.clone()]))
    }
}

/// For each block of a column whether it has anything other than zero.
fn occupied(column: &[f64]) -> Vec<bool> {
    blocks(column.len()).map(|rows| column[rows].iter().any(|v| *v != 0.0)).collect()
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
