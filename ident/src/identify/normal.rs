//! Accumulates normal equations row by row.

use multiversion::multiversion;
use nalgebra::{DMatrix, DVector};
use whirlstand_linalg::symmetric_eigen;

/// Inner products of the columns of a least-squares problem and of its residual.
///
/// Rows are added one at a time and processed in blocks, tile by tile, so that a tile of the sums stays in
/// registers. Columns that are zero throughout a block (modes that an output does not show) cost nothing.
#[derive(Debug, Clone)]
pub struct Normal {
    columns: usize,
    /// Number of columns rounded up to whole tiles.
    padded: usize,
    /// J'J, padded x padded, at and right of the diagonal.
    sums: Vec<f64>,
    /// J'r, padded.
    right: Vec<f64>,
    square: f64,
    pending: Vec<f64>,
    residuals: [f64; BLOCK],
    waiting: usize,
    rows: usize,
}

/// Rows of a block.
const BLOCK: usize = 16;
/// Columns of a tile; it has half as many rows.
const TILE: usize = 8;

impl Normal {
    /// Empty sums for `columns` unknowns.
    pub fn new(columns: usize) -> Self {
        let padded = columns.next_multiple_of(TILE);
        let zeros = |count: usize| vec![0.0; count];
        let (sums, right, pending) = (zeros(padded * padded), zeros(padded), zeros(BLOCK * padded));
        Self {
            columns,
            padded,
            sums,
            right,
            square: 0.0,
            pending,
            residuals: [0.0; BLOCK],
            waiting: 0,
            rows: 0,
        }
    }

    /// Adds a row: derivatives of the prediction by the unknowns, and measured minus predicted.
    #[inline]
    pub fn add(&mut self, slopes: &[f64], residual: f64) {
        self.pending[self.waiting * self.padded..][..self.columns].copy_from_slice(slopes);
        self.residuals[self.waiting] = residual;
        self.waiting += 1;
        self.rows += 1;
        if self.waiting == BLOCK {
            self.flush();
        }
    }

    fn flush(&mut self) {
        let residuals = &self.residuals[..self.waiting];
        self.square += residuals.iter().map(|r| r * r).sum::<f64>();
        gather(&mut self.sums, &mut self.right, &self.pending, residuals, self.padded);
        self.waiting = 0;
    }

    /// Number of rows so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Finishes the accumulation: information matrix J'J, J'r and r'r.
    pub fn finish(mut self) -> Sums {
        self.flush();
        let at = |a: usize, b: usize| self.sums[a.min(b) * self.padded + a.max(b)];
        Sums {
            information: DMatrix::from_fn(self.columns, self.columns, at),
            right: DVector::from_column_slice(&self.right[..self.columns]),
            square: self.square,
            rows: self.rows,
        }
    }
}

/// Adds the products of the columns of `rows` with each other, for every tile at or right of the diagonal, and with the
/// residuals.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn gather(sums: &mut [f64], right: &mut [f64], rows: &[f64], residuals: &[f64], padded: usize) {
    const HALF: usize = TILE / 2;
    for b in (0..padded).step_by(TILE) {
        let all = || rows.chunks_exact(padded).zip(residuals);
        let column = |row: &[f64]| -> [f64; TILE] { row[b..].first_chunk().copied().unwrap_or_default() };
        let (mut tile, mut size) = ([0.0; TILE], [0.0; TILE]);
        for (row, residual) in all() {
            let row = column(row);
            tile.iter_mut().zip(row).for_each(|(sum, r)| *sum += residual * r);
            size.iter_mut().zip(row).for_each(|(size, r)| *size += r.abs());
        }
        if size == [0.0; TILE] {
            continue;
        }
        right[b..].iter_mut().zip(tile).for_each(|(sum, t)| *sum += t);
        for a in (0..b + TILE).step_by(HALF) {
            let mut tile = [[0.0; TILE]; HALF];
            for (row, _) in all() {
                let Some(left) = row[a..].first_chunk::<HALF>() else { continue };
                let right = column(row);
                for (sum, l) in tile.iter_mut().zip(left) {
                    sum.iter_mut().zip(right).for_each(|(sum, r)| *sum += l * r);
                }
            }
            for (i, tile) in tile.iter().enumerate() {
                let sums = &mut sums[(a + i) * padded + b..][..TILE];
                sums.iter_mut().zip(tile).for_each(|(sum, t)| *sum += t);
            }
        }
    }
}

/// The normal equations of a least-squares problem with Jacobian J and residual r.
#[derive(Debug, Clone)]
pub struct Sums {
    /// Information matrix J'J, unknowns x unknowns.
    pub information: DMatrix<f64>,
    /// Right-hand side J'r.
    pub right: DVector<f64>,
    /// Sum of squared residuals r'r.
    pub square: f64,
    /// Number of rows.
    pub rows: usize,
}

impl Sums {
    /// The same by other unknowns, on which these depend by `turn`: these x others.
    pub fn by(&self, turn: &DMatrix<f64>) -> Self {
        Self {
            information: turn.transpose() * &self.information * turn,
            right: turn.transpose() * &self.right,
            ..*self
        }
    }

    /// Adds the sums over other rows.
    pub fn add(&mut self, other: &Self) {
        self.information += &other.information;
        self.right += &other.right;
        self.square += other.square;
        self.rows += other.rows;
    }

    /// Sum of squared residuals after the unknowns have moved by `step`, to second order (exact for a linear problem).
    pub fn square_after(&self, step: &DVector<f64>) -> f64 {
        (self.square - 2.0 * self.right.dot(step) + step.dot(&(&self.information * step))).max(0.0)
    }
}

/// Solves F x = g for symmetric F with columns scaled to one; directions that the data do not determine
/// (below 1e-11 of the strongest) stay at zero.
pub fn solve(information: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let inverse = pseudo_inverse(information)?;
    Some(inverse * right)
}

/// Pseudo-inverse of a symmetric matrix after scaling its diagonal to one; none when an entry is not finite
/// or its eigenvalues cannot be computed.
pub fn pseudo_inverse(information: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = information.nrows();
    if n == 0 {
        return Some(DMatrix::zeros(0, 0));
    }
    if information.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let scale: Vec<f64> = (0..n)
        .map(|i| if information[(i, i)] > 0.0 { 1.0 / information[(i, i)].sqrt() } else { 0.0 })
        .collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| information[(i, j)] * scale[i] * scale[j]);
    // Usual case: well conditioned, solved by the Cholesky factor.
    if scale.iter().all(|s| *s > 0.0)
        && let Some(factor) = scaled.clone().cholesky()
        && factor.l_dirty().diagonal().iter().all(|d| *d > 1e-4)
    {
        let inverse = factor.inverse();
        return Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]));
    }
    let (values, vectors) = symmetric_eigen(scaled).ok()?;
    let strongest = values.max();
    let mut inverse = DMatrix::zeros(n, n);
    for (value, vector) in values.iter().zip(vectors.column_iter()) {
        if *value > 1e-11 * strongest {
            inverse.ger(1.0 / value, &vector, &vector, 1.0);
        }
    }
    Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_the_whole_matrix_whatever_the_number_of_rows() {
        for rows in [3usize, 16, 41] {
            let j = DMatrix::from_fn(rows, 3, |i, k| ((5 * i + 3 * k) as f64).cos());
            let r = DVector::from_fn(rows, |i, _| (i as f64).sin());
            let mut normal = Normal::new(3);
            for i in 0..rows {
                normal.add(&[j[(i, 0)], j[(i, 1)], j[(i, 2)]], r[i]);
            }
            let sums = normal.finish();
            assert!((&sums.information - j.transpose() * &j).norm() < 1e-12);
            assert!((&sums.right - j.transpose() * &r).norm() < 1e-12);
            assert!((sums.square - r.norm_squared()).abs() < 1e-12);
            let step = DVector::from_vec(vec![0.1, -0.2, 0.3]);
            assert!((sums.square_after(&step) - (&r - &j * &step).norm_squared()).abs() < 1e-12);
        }
    }

    #[test]
    fn a_direction_without_data_stays_at_zero() {
        let f = DMatrix::from_row_slice(3, 3, &[2.0, 2.0, 0.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        let x = solve(&f, &DVector::from_vec(vec![2.0, 2.0, 0.0])).unwrap();
        assert!((x[0] - 0.5).abs() < 1e-9 && (x[1] - 0.5).abs() < 1e-9 && x[2] == 0.0, "{x}");
    }
}
