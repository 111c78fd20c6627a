//! The generalised complex Schur form of a matrix pencil, and its reordering.
//!
//! Reduction to Hessenberg-triangular form and single-shift QZ iteration after Moler and Stewart (SIAM J. Numer.
//! Anal. 10, 1973) as told in Golub and Van Loan, Matrix Computations, section 7.7; adjacent eigenvalues are
//! exchanged by the unitary swap of Van Dooren (SIAM J. Sci. Stat. Comput. 2, 1981). In complex arithmetic each
//! swap is a pair of plane rotations, hence unconditionally backward stable, which 2 x 2 real blocks are not.

use nalgebra::DMatrix;

use super::scale::{is_finite, scale, unit_exponent};
use super::{C64, DecompositionError};

/// Most sweeps per eigenvalue on average, as in LAPACK; two or three are usual.
const SWEEPS: usize = 30;

/// Number of sweeps without an eigenvalue after which an exceptional shift breaks a possible cycle, as for a
/// permutation.
const EXCEPTIONAL: usize = 10;

/// `A = Q S Z^H` and `B = Q T Z^H` with `Q`, `Z` unitary and `S`, `T` upper triangular.
#[derive(Debug, Clone)]
pub struct GeneralizedSchur {
    /// Upper triangular factor of `A`.
    pub s: DMatrix<C64>,
    /// Upper triangular factor of `B`.
    pub t: DMatrix<C64>,
    /// Left unitary factor.
    pub q: DMatrix<C64>,
    /// Right unitary factor; its first k columns span the deflating subspace of the first k eigenvalues.
    pub z: DMatrix<C64>,
}

/// A unitary 2 x 2 matrix `[[c, s], [-conj(s), c]]` with real `c`.
#[derive(Clone, Copy)]
struct Rotation {
    c: f64,
    s: C64,
}

impl Rotation {
    /// The rotation that takes `(f, g)` to `(r, 0)`.
    fn annihilating(f: C64, g: C64) -> Self {
        let gn = g.norm();
        if gn == 0.0 {
            return Self { c: 1.0, s: C64::new(0.0, 0.0) };
        }
        let fnorm = f.norm();
        if fnorm == 0.0 {
            return Self { c: 0.0, s: g.conj() / gn };
        }
        let h = fnorm.hypot(gn);
        Self { c: fnorm / h, s: (f / fnorm) * g.conj() / h }
    }

    /// Applies the rotation to rows `i`, `k` of `m`, columns `from..`, from the left.
    fn rows(self, m: &mut DMatrix<C64>, i: usize, k: usize, from: usize) {
        for j in from..m.ncols() {
            let (x, y) = (m[(i, j)], m[(k, j)]);
            m[(i, j)] = x * self.c + self.s * y;
            m[(k, j)] = y * self.c - self.s.conj() * x;
        }
    }

    /// Applies the conjugate transpose of the rotation to columns `i`, `k` of `m`, rows `..to`, from the
    /// right.
    fn columns(self, m: &mut DMatrix<C64>, i: usize, k: usize, to: usize) {
        for r in 0..to {
            let (x, y) = (m[(r, i)], m[(r, k)]);
            m[(r, i)] = x * self.c + self.s.conj() * y;
            m[(r, k)] = y * self.c - self.s * x;
        }
    }
}

impl GeneralizedSchur {
    /// Factorises the square pencil `(a, b)`, both n x n.
    ///
    /// # Errors
    /// [`DecompositionError`] when an entry is not finite or the iteration (30 n sweeps) does not converge.
    pub fn new(a: &DMatrix<C64>, b: &DMatrix<C64>) -> Result<Self, DecompositionError> {
        if !is_finite(a) || !is_finite(b) {
            return Err(DecompositionError::NotFinite);
        }
        let n = a.nrows();
        let identity = DMatrix::<C64>::identity(n, n);
        let mut f = Self { s: a.clone(), t: b.clone(), q: identity.clone(), z: identity };
        let sizes = (unit_exponent(a), unit_exponent(b));
        scale(&mut f.s, -sizes.0);
        scale(&mut f.t, -sizes.1);
        f.reduce();
        f.iterate()?;
        scale(&mut f.s, sizes.0);
        scale(&mut f.t, sizes.1);
        if [&f.s, &f.t, &f.q, &f.z].into_iter().all(is_finite) {
            Ok(f)
        } else {
            Err(DecompositionError::NotFinite)
        }
    }

    /// Applies a left rotation to rows `i`, `k` of both factors, and accumulates it in `q`.
    fn left(&mut self, rot: Rotation, i: usize, k: usize) {
        rot.rows(&mut self.s, i, k, 0);
        rot.rows(&mut self.t, i, k, 0);
        let n = self.q.nrows();
        rot.columns(&mut self.q, i, k, n);
    }

    /// Applies a right rotation to columns `i`, `k` of both factors, and accumulates it in `z`.
    fn right(&mut self, rot: Rotation, i: usize, k: usize) {
        let n = self.z.nrows();
        rot.columns(&mut self.s, i, k, n);
        rot.columns(&mut self.t, i, k, n);
        rot.columns(&mut self.z, i, k, n);
    }

    /// The right rotation that puts a zero at `m[(row, k - 1)]`, using column `k`.
    fn right_annihilating(m: &DMatrix<C64>, row: usize, k: usize) -> Rotation {
        // columns(k, k - 1): the second becomes y c - s x with y = m[k-1], x = m[k].
        Rotation::annihilating(m[(row, k)].conj(), m[(row, k - 1)].conj())
    }

    /// Reduces the pencil to Hessenberg-triangular form by plane rotations.
    fn reduce(&mut self) {
        let n = self.s.nrows();
        let zero = C64::new(0.0, 0.0);
        for j in 0..n.saturating_sub(1) {
            for i in (j + 1..n).rev() {
                if self.t[(i, j)] != zero {
                    let rot = Rotation::annihilating(self.t[(i - 1, j)], self.t[(i, j)]);
                    self.left(rot, i - 1, i);
                    self.t[(i, j)] = zero;
                }
            }
        }
        for j in 0..n.saturating_sub(2) {
            for i in (j + 2..n).rev() {
                if self.s[(i, j)] != zero {
                    let rot = Rotation::annihilating(self.s[(i - 1, j)], self.s[(i, j)]);
                    self.left(rot, i - 1, i);
                    self.s[(i, j)] = zero;
                }
                if self.t[(i, i - 1)] != zero {
                    let rot = Self::right_annihilating(&self.t, i, i);
                    self.right(rot, i, i - 1);
                    self.t[(i, i - 1)] = zero;
                }
            }
        }
    }

    fn iterate(&mut self) -> Result<(), DecompositionError> {
        let n = self.s.nrows();
        let zero = C64::new(0.0, 0.0);
        let (s_floor, t_floor) = (f64::EPSILON * self.s.norm(), f64::EPSILON * self.t.norm());
        let mut last = n.saturating_sub(1);
        let (mut total, mut sweeps) = (0, 0);
        let mut exceptional = zero;
        while last > 0 {
            if self.s[(last, last - 1)].norm() <= s_floor {
                self.s[(last, last - 1)] = zero;
                last -= 1;
                (sweeps, exceptional) = (0, zero);
                continue;
            }
            if self.t[(last, last)].norm() <= t_floor {
                // An infinite eigenvalue at the bottom: one rotation separates it.
                self.t[(last, last)] = zero;
                let rot = Self::right_annihilating(&self.s, last, last);
                self.right(rot, last, last - 1);
                self.s[(last, last - 1)] = zero;
                last -= 1;
                (sweeps, exceptional) = (0, zero);
                continue;
            }
            let mut first = last;
            while first > 0 {
                if self.s[(first, first - 1)].norm() <= s_floor {
                    self.s[(first, first - 1)] = zero;
                    break;
                }
                first -= 1;
            }
            if let Some(k) = (first..last).find(|&k| self.t[(k, k)].norm() <= t_floor) {
                self.chase_infinite(k, first, last);
                continue;
            }
            (total, sweeps) = (total + 1, sweeps + 1);
            if total > SWEEPS * n.max(10) {
                return Err(DecompositionError::NoConvergence { what: "eigenvalues" });
            }
            let shift = if sweeps % EXCEPTIONAL == 0 {
                exceptional += self.s[(last, last - 1)] / self.t[(last - 1, last - 1)];
                exceptional
            } else {
                self.shift(last)
            };
            self.sweep(first, last, shift);
        }
        Ok(())
    }

    /// Moves a zero on the diagonal of `t` from `k` down to `last`.
    fn chase_infinite(&mut self, k: usize, first: usize, last: usize) {
        let zero = C64::new(0.0, 0.0);
        self.t[(k, k)] = zero;
        for j in k..last {
            let rot = Rotation::annihilating(self.t[(j, j + 1)], self.t[(j + 1, j + 1)]);
            self.left(rot, j, j + 1);
            self.t[(j + 1, j + 1)] = zero;
            if j > first {
                let rot = Self::right_annihilating(&self.s, j + 1, j);
                self.right(rot, j, j - 1);
                self.s[(j + 1, j - 1)] = zero;
            }
        }
    }

    /// Wilkinson's shift: the eigenvalue of the trailing 2 x 2 block of `s t^-1` nearest to its corner.
    fn shift(&self, last: usize) -> C64 {
        let p = last - 1;
        let (b11, b12, b22) = (self.t[(p, p)], self.t[(p, last)], self.t[(last, last)]);
        let (m11, m21) = (self.s[(p, p)] / b11, self.s[(last, p)] / b11);
        let m12 = (self.s[(p, last)] - m11 * b12) / b22;
        let m22 = (self.s[(last, last)] - m21 * b12) / b22;
        let half = (m11 - m22) * 0.5;
        let root = (half * half + m12 * m21).sqrt();
        let denominator =
            if (half + root).norm() >= (half - root).norm() { half + root } else { half - root };
        if denominator.norm() == 0.0 { m22 } else { m22 - m12 * m21 / denominator }
    }

    /// One implicit single-shift sweep over the active block.
    fn sweep(&mut self, first: usize, last: usize, shift: C64) {
        let zero = C64::new(0.0, 0.0);
        let mut f = self.s[(first, first)] - shift * self.t[(first, first)];
        let mut g = self.s[(first + 1, first)];
        for j in first..last {
            if j > first {
                (f, g) = (self.s[(j, j - 1)], self.s[(j + 1, j - 1)]);
            }
            let rot = Rotation::annihilating(f, g);
            self.left(rot, j, j + 1);
            if j > first {
                self.s[(j + 1, j - 1)] = zero;
            }
            let rot = Self::right_annihilating(&self.t, j + 1, j + 1);
            self.right(rot, j + 1, j);
            self.t[(j + 1, j)] = zero;
        }
    }

    /// Eigenvalue `k` as the pair `(alpha, beta)`; it is infinite when `beta` is zero.
    pub fn eigenvalue(&self, k: usize) -> (C64, C64) {
        (self.s[(k, k)], self.t[(k, k)])
    }

    /// Moves the selected eigenvalues to the top by exchanges of neighbours.
    pub fn reorder(&mut self, selected: &[bool]) {
        let mut marks = selected.to_vec();
        let mut top = 0;
        for k in 0..marks.len() {
            if marks[k] {
                for j in (top..k).rev() {
                    self.swap(j);
                    marks.swap(j, j + 1);
                }
                top += 1;
            }
        }
    }

    /// Exchanges the eigenvalues at `k` and `k + 1`.
    fn swap(&mut self, k: usize) {
        let zero = C64::new(0.0, 0.0);
        let (s11, s12, s22) = (self.s[(k, k)], self.s[(k, k + 1)], self.s[(k + 1, k + 1)]);
        let (t11, t12, t22) = (self.t[(k, k)], self.t[(k, k + 1)], self.t[(k + 1, k + 1)]);
        // (g, -f) is the eigenvector of the second eigenvalue within the block.
        let f = s22 * t11 - t22 * s11;
        let g = s22 * t12 - t22 * s12;
        // The first column becomes x c + conj(s) y, which this rotation makes proportional to g x - f y.
        let rot = Rotation::annihilating(g, -f);
        self.right(rot, k, k + 1);
        // Both products are parallel; the larger one is more accurate.
        let by_s = s22.norm() * t11.norm() >= s11.norm() * t22.norm();
        let m = if by_s { &self.s } else { &self.t };
        let rot = Rotation::annihilating(m[(k, k)], m[(k + 1, k)]);
        self.left(rot, k, k + 1);
        self.s[(k + 1, k)] = zero;
        self.t[(k + 1, k)] = zero;
    }
}
