//! Normal equations, gathered row by row.

use nalgebra::{DMatrix, DVector};

/// Sums of products of the columns of a least-squares problem, the last column being the residual.
///
/// Rows come one at a time and are added four at a time, so that the sums are read and written once for four rows.
#[derive(Debug, Clone)]
pub struct Normal {
    width: usize,
    sums: Vec<f64>,
    pending: Vec<f64>,
    rows: usize,
}

const BLOCK: usize = 4;

impl Normal {
    /// For `columns` unknowns.
    pub fn new(columns: usize) -> Self {
        let width = columns + 1;
        Self { width, sums: vec![0.0; width * width], pending: Vec::with_capacity(BLOCK * width), rows: 0 }
    }

    /// Adds a row: derivatives of the prediction by the unknowns, and measured minus predicted.
    #[inline]
    pub fn add(&mut self, slopes: &[f64], residual: f64) {
        self.pending.extend_from_slice(slopes);
        self.pending.push(residual);
        self.rows += 1;
        if self.pending.len() == BLOCK * self.width {
            self.flush();
        }
    }

    fn flush(&mut self) {
        let w = self.width;
        if self.pending.len() == BLOCK * w {
            let (r0, rest) = self.pending.split_at(w);
            let (r1, rest) = rest.split_at(w);
            let (r2, r3) = rest.split_at(w);
            for a in 0..w {
                let (s0, s1, s2, s3) = (r0[a], r1[a], r2[a], r3[a]);
                let sums = &mut self.sums[a * w + a..(a + 1) * w];
                let columns = r0[a..].iter().zip(&r1[a..]).zip(r2[a..].iter().zip(&r3[a..]));
                for (sum, ((x0, x1), (x2, x3))) in sums.iter_mut().zip(columns) {
                    *sum += s0 * x0 + s1 * x1 + s2 * x2 + s3 * x3;
                }
            }
        } else {
            for row in self.pending.chunks_exact(w) {
                for a in 0..w {
                    let s = row[a];
                    let sums = &mut self.sums[a * w + a..(a + 1) * w];
                    sums.iter_mut().zip(&row[a..]).for_each(|(sum, x)| *sum += s * x);
                }
            }
        }
        self.pending.clear();
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Ends the gathering: information matrix J'J, J'r and r'r.
    pub fn finish(mut self) -> Sums {
        self.flush();
        let (w, q) = (self.width, self.width - 1);
        let at = |a: usize, b: usize| self.sums[a.min(b) * w + a.max(b)];
        Sums {
            information: DMatrix::from_fn(q, q, at),
            right: DVector::from_fn(q, |a, _| at(a, q)),
            square: at(q, q),
            rows: self.rows,
        }
    }
}

/// J'J, J'r, r'r and the number of rows.
#[derive(Debug, Clone)]
pub struct Sums {
    /// J'J.
    pub information: DMatrix<f64>,
    /// J'r.
    pub right: DVector<f64>,
    /// r'r.
    pub square: f64,
    /// Number of rows.
    pub rows: usize,
}

impl Sums {
    /// r'r after the unknowns have moved by `step`, to second order (exact for a linear problem).
    pub fn square_after(&self, step: &DVector<f64>) -> f64 {
        (self.square - 2.0 * self.right.dot(step) + step.dot(&(&self.information * step))).max(0.0)
    }
}

/// Solves F x = g for symmetric F with columns scaled to one; directions that the data do not show (below 1e-11 of
/// the strongest) stay at zero.
pub fn solve(information: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let inverse = pseudo_inverse(information)?;
    Some(inverse * right)
}

/// The inverse of a symmetric matrix on the directions that it shows, after scaling its diagonal to one.
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
    // The usual case: well conditioned, solved by Cholesky's factor.
    if scale.iter().all(|s| *s > 0.0)
        && let Some(factor) = scaled.clone().cholesky()
        && factor.l_dirty().diagonal().iter().all(|d| *d > 1e-4)
    {
        let inverse = factor.inverse();
        return Some(DMatrix::from_fn(n, n, |i, j| inverse[(i, j)] * scale[i] * scale[j]));
    }
    let eigen = scaled.symmetric_eigen();
    let strongest = eigen.eigenvalues.max();
    let mut inverse = DMatrix::zeros(n, n);
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
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
        for rows in [3usize, 4, 9] {
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
