//! Accumulates normal equations row by row.

use multiversion::multiversion;
use nalgebra::{DMatrix, DVector};
use whirlstand_linalg::symmetric_eigen;

/// Inner products of the columns of a least-squares problem, the last column being the residual.
///
/// Rows are added one at a time and processed in blocks, tile by tile, so that a tile of the sums stays in
/// registers. Columns that are zero throughout a block (modes that an output does not show) cost nothing.
#[derive(Debug, Clone)]
pub struct Normal {
    width: usize,
    /// Width rounded up to whole tiles.
    padded: usize,
    sums: Vec<f64>,
    pending: Vec<f64>,
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
        let width = columns + 1;
        let padded = width.next_multiple_of(TILE);
        let (sums, pending) = (vec![0.0; padded * padded], vec![0.0; BLOCK * padded]);
        Self { width, padded, sums, pending, waiting: 0, rows: 0 }
    }

    /// Adds a row: derivatives of the prediction by the unknowns, and measured minus predicted.
    #[inline]
    pub fn add(&mut self, slopes: &[f64], residual: f64) {
        let row = &mut self.pending[self.waiting * self.padded..][..self.width];
        row[..slopes.len()].copy_from_slice(slopes);
        row[slopes.len()] = residual;
        self.waiting += 1;
        self.rows += 1;
        if self.waiting == BLOCK {
            self.flush();
        }
    }

    fn flush(&mut self) {
        gather(&mut self.sums, &self.pending[..self.waiting * self.padded], self.padded);
        self.waiting = 0;
    }

    /// Number of rows so far.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Finishes the accumulation: information matrix J'J, J'r and r'r.
    pub fn finish(mut self) -> Sums {
        self.flush();
        let q = self.width - 1;
        let at = |a: usize, b: usize| self.sums[a.min(b) * self.padded + a.max(b)];
        Sums {
            information: DMatrix::from_fn(q, q, at),
            right: DVector::from_fn(q, |a, _| at(a, q)),
            square: at(q, q),
            rows: self.rows,
        }
    }
}

/// Adds the products of the columns of `rows`, for every tile at or right of the diagonal.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn gather(sums: &mut [f64], rows: &[f64], padded: usize) {
    const HALF: usize = TILE / 2;
    let empty = |tile: usize| rows.chunks_exact(padded).all(|row| row[tile..tile + TILE] == [0.0; TILE]);
    for b in (0..padded).step_by(TILE) {
        if empty(b) {
            continue;
        }
        for a in (0..b + TILE).step_by(HALF) {
            let mut tile = [[0.0; TILE]; HALF];
            for row in rows.chunks_exact(padded) {
                let (Some(left), Some(right)) =
                    (row[a..].first_chunk::<HALF>(), row[b..].first_chunk::<TILE>())
                else {
                    continue;
                };
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
