//! Choice of eigenvectors: the subspaces that feedback can assign, and sweeps that raise their determinant.

use nalgebra::{ComplexField, DMatrix, DVector};
use whirlstand_linalg::{C64, DecompositionError, Svd, complex, singular_values, symmetric_eigen};

/// Assignable and chosen eigenvectors. Column j of a pair holds the real part, j + 1 the imaginary part.
pub struct Eigenvectors {
    poles: Vec<C64>,
    spaces: Vec<DMatrix<C64>>,
    x: DMatrix<f64>,
}

impl Eigenvectors {
    /// The assignable subspaces of eigenvectors, with none chosen yet.
    pub fn new(
        a: &DMatrix<f64>,
        annihilator: &DMatrix<f64>,
        poles: &[C64],
    ) -> Result<Self, DecompositionError> {
        let n = a.nrows();
        let rank = n - annihilator.ncols();
        let projected = annihilator.transpose();
        let space = |p: &C64| {
            let mut shifted = a.clone();
            (0..n).for_each(|i| shifted[(i, i)] -= p.re);
            let shifted = &projected * shifted;
            if p.im == 0.0 {
                return Ok(complex(&null_space(&shifted, rank)?));
            }
            let imaginary = complex(&projected) * C64::new(0.0, p.im);
            null_space(&(complex(&shifted) - imaginary), rank)
        };
        let spaces = poles.iter().map(space).collect::<Result<_, _>>()?;
        Ok(Self { poles: poles.to_vec(), spaces, x: DMatrix::zeros(n, n) })
    }

    /// True when there is a choice: with several inputs, or at an uncontrollable mode, whose eigenvector the
    /// gain may still change.
    pub fn are_free(&self) -> bool {
        self.spaces.iter().any(|space| space.ncols() > 1)
    }

    /// The chosen eigenvectors, as columns.
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.x
    }

    /// Initial choice: the projection of a fixed generic vector onto each subspace, different for every
    /// `start`. It does not depend on the bases of the subspaces, which depend on rounding.
    pub fn start(&mut self, start: usize) {
        let mut j = 0;
        while j < self.poles.len() {
            let space = &self.spaces[j];
            let w = DVector::from_fn(space.nrows(), |i, _| {
                let t = (i * 7 + j * 13 + start * 29 + 3) as f64;
                C64::new((t * 0.731).sin() + 0.5, (t * 1.317).cos())
            });
            let v = space * space.ad_mul(&w);
            if self.poles[j].im == 0.0 {
                self.set(j, &v.map(|v| v.re));
                j += 1;
            } else {
                self.set_pair(j, &v);
                j += 2;
            }
        }
    }

    fn set(&mut self, j: usize, v: &DVector<f64>) {
        let norm = v.norm();
        if norm > 0.0 {
            self.x.set_column(j, &(v / norm));
        }
    }

    fn set_pair(&mut self, j: usize, v: &DVector<C64>) {
        // Both parts together have norm sqrt(2), so that a pair has the weight of two real vectors.
        let v = v * C64::new(std::f64::consts::SQRT_2 / v.norm(), 0.0);
        self.x.set_column(j, &v.map(|c| c.re));
        self.x.set_column(j + 1, &v.map(|c| c.im));
    }

    /// Condition number of the matrix of unit eigenvectors.
    pub fn condition(&self) -> Result<f64, DecompositionError> {
        let n = self.poles.len();
        let mut x = DMatrix::<C64>::zeros(n, n);
        let mut j = 0;
        while j < n {
            if self.poles[j].im == 0.0 {
                x.set_column(j, &self.x.column(j).map(|v| C64::new(v, 0.0)));
                j += 1;
            } else {
                let v = DVector::from_fn(n, |i, _| C64::new(self.x[(i, j)], self.x[(i, j + 1)]));
                let v = &v / C64::new(v.norm(), 0.0);
                x.set_column(j + 1, &v.map(|c| c.conj()));
                x.set_column(j, &v);
                j += 2;
            }
        }
        let s = singular_values(&x)?;
        Ok(s.max() / s.min())
    }

    /// Raises the determinant until sweeps bring no significant gain, at most `limit` sweeps; returns their
    /// number.
    pub fn improve(&mut self, limit: usize) -> Result<usize, DecompositionError> {
        let n = self.poles.len();
        if n < 2 {
            return Ok(0);
        }
        let reals = self.poles.iter().filter(|p| p.im == 0.0).count();
        let mut before = self.log_determinant();
        for sweep in 1..=limit {
            if reals == 1 {
                self.update_single(0)?;
            }
            for i in 0..reals {
                // Neighbours, and more distant partners in turn.
                let k = (i + 1 + (sweep - 1) % (reals - 1).max(1)) % reals;
                if k != i {
                    self.update_real_pair(i.min(k), i.max(k))?;
                }
            }
            for j in (reals..n).step_by(2) {
                self.update_complex(j)?;
            }
            let after = self.log_determinant();
            if sweep >= reals.max(3) && after - before < 1e-5 {
                return Ok(sweep);
            }
            before = after;
        }
        Ok(limit)
    }

    fn log_determinant(&self) -> f64 {
        let d = self.x.clone().qr().r();
        d.diagonal().iter().map(|v| v.abs().max(f64::MIN_POSITIVE).ln()).sum()
    }

    /// Orthonormal basis of the complement of all columns but those given.
    fn complement(&self, skip: &[usize]) -> Result<DMatrix<f64>, DecompositionError> {
        let n = self.poles.len();
        let kept: Vec<usize> = (0..n).filter(|j| !skip.contains(j)).collect();
        let others = DMatrix::from_fn(kept.len(), n, |i, k| self.x[(k, kept[i])]);
        let basis = null_space(&others, skip.len())?;
        Ok(basis.columns(basis.ncols() - skip.len(), skip.len()).into_owned())
    }

    /// Updates one real vector: the projection of the others' normal onto its subspace (method 0).
    fn update_single(&mut self, j: usize) -> Result<(), DecompositionError> {
        let normal = self.complement(&[j])?;
        let space = self.real_space(j);
        let v = &space * space.tr_mul(&normal.column(0));
        if v.norm() > 1e-12 {
            self.set(j, &v);
        }
        Ok(())
    }

    /// Updates two real vectors at once: with u1, u2 normal to the others, the determinant is bilinear in the
    /// two, and the best pair is the leading singular pair.
    fn update_real_pair(&mut self, i: usize, k: usize) -> Result<(), DecompositionError> {
        let u = self.complement(&[i, k])?;
        let skew = u.column(0) * u.column(1).transpose() - u.column(1) * u.column(0).transpose();
        let (si, sk) = (self.real_space(i), self.real_space(k));
        let svd = Svd::new(&(si.transpose() * skew * &sk))?;
        let best = svd.values.imax();
        if svd.values[best] > 1e-12 {
            self.set(i, &(si * svd.u.column(best)));
            self.set(k, &(sk * svd.v_t.row(best).transpose()));
        }
        Ok(())
    }

    /// Updates a complex pair: the determinant is a Hermitian form in the vector's coordinates, and the best
    /// vector belongs to its eigenvalue of largest magnitude.
    fn update_complex(&mut self, j: usize) -> Result<(), DecompositionError> {
        let u = self.complement(&[j, j + 1])?;
        let skew = u.column(0) * u.column(1).transpose() - u.column(1) * u.column(0).transpose();
        let space = &self.spaces[j];
        let form = space.adjoint() * complex(&skew) * space * C64::new(0.0, -0.5);
        let (values, vectors) = symmetric_eigen(form)?;
        let best = values.iamax();
        if values[best].abs() > 1e-12 {
            let v = space * vectors.column(best);
            self.set_pair(j, &v);
        }
        Ok(())
    }

    /// The subspace of a real pole, which is real.
    fn real_space(&self, j: usize) -> DMatrix<f64> {
        self.spaces[j].map(|v| v.re)
    }
}

/// Orthonormal basis of the null space of `a`, taken as having at least `at_least` dimensions: that many right
/// singular vectors of the smallest singular values, more when more of these vanish.
///
/// # Errors
/// [`DecompositionError`] when the singular values of `a` do not converge.
pub fn null_space<T: ComplexField<RealField = f64>>(
    a: &DMatrix<T>,
    at_least: usize,
) -> Result<DMatrix<T>, DecompositionError> {
    let (rows, n) = a.shape();
    // A square matrix, as a thin decomposition has only min(rows, columns) right vectors.
    let mut square = DMatrix::<T>::zeros(n.max(rows), n);
    square.view_mut((0, 0), (rows, n)).copy_from(a);
    let svd = Svd::new(&square)?;
    let vanishing = n - svd.rank(svd.values.max() * f64::EPSILON * n as f64 * 10.0);
    let count = vanishing.max(at_least).min(n);
    Ok(svd.v_t.rows(n - count, count).adjoint())
}
