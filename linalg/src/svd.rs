//! Singular values by one-sided Jacobi rotations, and results derived from them.
//!
//! Pairs of columns are rotated until all are orthogonal (Hestenes, J. SIAM 6, 1958; Demmel and Veselic, SIAM J.
//! Matrix Anal. Appl. 13, 1992). Small singular values have the same relative accuracy as large ones. nalgebra's
//! implicit QR iteration is not used: it does not end for some matrices, and for the 9 x 9 matrix of ones it gives
//! 11.25 for the only nonzero singular value, nine.

use nalgebra::{ComplexField, DMatrix, DVector};

use super::DecompositionError;

/// Most sweeps over all pairs of columns; about ten are usual.
const SWEEPS: usize = 60;

/// Norm below which a column counts as zero, where the largest entry of the matrix is about one; its square does
/// not underflow.
const ZERO: f64 = 1e-150;

/// `A = U diag(values) V'`, thin: U is n x k, V' k x m with k the smaller of n and m.
#[derive(Debug, Clone)]
pub struct Svd<T: ComplexField> {
    /// Left singular vectors, as columns.
    pub u: DMatrix<T>,
    /// Singular values, the largest first.
    pub values: DVector<f64>,
    /// Right singular vectors, as rows, conjugated.
    pub v_t: DMatrix<T>,
}

impl<T: ComplexField<RealField = f64>> Svd<T> {
    /// Decomposes `a`, n x m; either may be zero.
    ///
    /// # Errors
    /// [`DecompositionError`] when an entry is not finite or the rotations do not converge.
    pub fn new(a: &DMatrix<T>) -> Result<Self, DecompositionError> {
        if a.nrows() < a.ncols() {
            let Self { u, values, v_t } = Self::new(&a.adjoint())?;
            return Ok(Self { u: v_t.adjoint(), values, v_t: u.adjoint() });
        }
        let (mut u, exponent) = unit_sized(a)?;
        let mut v = DMatrix::identity(a.ncols(), a.ncols());
        orthogonalise(&mut u, Some(&mut v))?;
        let norms: Vec<f64> = u.column_iter().map(|c| c.norm()).collect();
        let mut order: Vec<usize> = (0..norms.len()).collect();
        order.sort_by(|i, j| norms[*j].total_cmp(&norms[*i]));
        let mut u = u.select_columns(&order);
        for (k, &i) in order.iter().enumerate() {
            if norms[i] > ZERO {
                u.column_mut(k).unscale_mut(norms[i]);
            } else {
                complete(&mut u, k);
            }
        }
        let values = DVector::from_iterator(order.len(), order.iter().map(|i| norms[*i]));
        Ok(Self { u, values: sized(values, exponent)?, v_t: v.select_columns(&order).adjoint() })
    }

    /// Number of singular values above `floor`.
    pub fn rank(&self, floor: f64) -> usize {
        self.values.iter().filter(|s| **s > floor).count()
    }
}

/// Singular values of `a`, n x m, the largest first.
///
/// # Errors
/// As [`Svd::new`].
pub fn singular_values<T>(a: &DMatrix<T>) -> Result<DVector<f64>, DecompositionError>
where
    T: ComplexField<RealField = f64>,
{
    let (mut u, exponent) = unit_sized(a)?;
    if u.nrows() < u.ncols() {
        u = u.adjoint();
    }
    orthogonalise(&mut u, None)?;
    let mut values: Vec<f64> = u.column_iter().map(|c| c.norm()).collect();
    values.sort_by(|x, y| y.total_cmp(x));
    sized(values.into(), exponent)
}

/// The pseudo-inverse of `a`, n x m; singular values up to `floor` count as zero. It is m x n.
///
/// # Errors
/// As [`Svd::new`].
pub fn pseudo_inverse(a: &DMatrix<f64>, floor: f64) -> Result<DMatrix<f64>, DecompositionError> {
    let Svd { mut u, values, v_t } = Svd::new(a)?;
    for (mut column, value) in u.column_iter_mut().zip(&values) {
        column.scale_mut(if *value > floor { 1.0 / value } else { 0.0 });
    }
    Ok((u * v_t).transpose())
}

/// `a` divided by the power of two that scales its largest entry to about one, and the exponent.
fn unit_sized<T>(a: &DMatrix<T>) -> Result<(DMatrix<T>, i32), DecompositionError>
where
    T: ComplexField<RealField = f64>,
{
    if a.iter().any(|v| !v.is_finite()) {
        return Err(DecompositionError::NotFinite);
    }
    let largest =
        a.iter().map(|v| v.clone().real().abs().max(v.clone().imaginary().abs())).fold(0.0, f64::max);
    let exponent = if largest > 0.0 { largest.log2() as i32 } else { 0 };
    // In two steps, as the power itself may overflow.
    let (half, rest) = (f64::powi(0.5, exponent / 2), f64::powi(0.5, exponent - exponent / 2));
    Ok((a.map(|v| v.scale(half).scale(rest)), exponent))
}

fn sized(values: DVector<f64>, exponent: i32) -> Result<DVector<f64>, DecompositionError> {
    let (half, rest) = (f64::powi(2.0, exponent / 2), f64::powi(2.0, exponent - exponent / 2));
    let values = values.map(|v| v * half * rest);
    if values.iter().all(|v| v.is_finite()) { Ok(values) } else { Err(DecompositionError::NotFinite) }
}

/// Rotates the columns of `u` until they are orthogonal, and those of `v` in the same way.
fn orthogonalise<T>(u: &mut DMatrix<T>, mut v: Option<&mut DMatrix<T>>) -> Result<(), DecompositionError>
where
    T: ComplexField<RealField = f64>,
{
    let m = u.ncols();
    let right_angle = f64::EPSILON * u.nrows() as f64;
    for _ in 0..SWEEPS {
        let mut turned = false;
        for p in 0..m {
            for q in p + 1..m {
                let (np, nq) = (u.column(p).norm(), u.column(q).norm());
                let product = u.column(p).dotc(&u.column(q));
                let size = product.clone().modulus();
                if np <= ZERO || nq <= ZERO || size <= right_angle * np * nq {
                    continue;
                }
                turned = true;
                let phase = product.unscale(size).conjugate();
                let zeta = 0.5 * (nq / np - np / nq) * (np * nq / size);
                let tangent = 1f64.copysign(zeta) / (zeta.abs() + zeta.hypot(1.0));
                turn(u, p, q, &phase, tangent);
                if let Some(v) = v.as_deref_mut() {
                    turn(v, p, q, &phase, tangent);
                }
            }
        }
        if !turned {
            return Ok(());
        }
    }
    Err(DecompositionError::NoConvergence { what: "singular values" })
}

/// Multiplies column q by `phase`, then rotates columns p and q by the angle with this tangent.
fn turn<T>(m: &mut DMatrix<T>, p: usize, q: usize, phase: &T, tangent: f64)
where
    T: ComplexField<RealField = f64>,
{
    let c = 1.0 / tangent.hypot(1.0);
    let s = c * tangent;
    for i in 0..m.nrows() {
        let (x, y) = (m[(i, p)].clone(), m[(i, q)].clone() * phase.clone());
        m[(i, p)] = x.clone().scale(c) - y.clone().scale(s);
        m[(i, q)] = x.scale(s) + y.scale(c);
    }
}

/// Replaces column k by a unit vector orthogonal to the columns before it: the remainder of the unit vector that
/// they contain least of.
fn complete<T>(u: &mut DMatrix<T>, k: usize)
where
    T: ComplexField<RealField = f64>,
{
    let share = |i: usize| (0..k).map(|j| u[(i, j)].clone().modulus_squared()).sum::<f64>();
    let shares: Vec<f64> = (0..u.nrows()).map(share).collect();
    let least = (0..shares.len()).min_by(|i, j| shares[*i].total_cmp(&shares[*j])).unwrap_or(0);
    let mut left = DVector::<T>::zeros(u.nrows());
    left[least] = T::one();
    // The second pass removes the rounding errors of the first one.
    for _ in 0..2 {
        for j in 0..k {
            let part = u.column(j).dotc(&left);
            left -= u.column(j) * part;
        }
        let norm = left.norm();
        left.unscale_mut(norm);
    }
    u.set_column(k, &left);
}
