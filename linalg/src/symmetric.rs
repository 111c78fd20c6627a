//! Eigenvalues and eigenvectors of symmetric and Hermitian matrices.

use nalgebra::{ComplexField, DMatrix, DVector, SymmetricEigen};

use super::DecompositionError;

/// Most sweeps of the QR iteration per eigenvalue; LAPACK allows thirty.
const SWEEPS: usize = 60;

/// Real eigenvalues and orthonormal eigenvectors, the columns, of the Hermitian n x n matrix `a`, of which the lower half
/// is read; in no particular order.
///
/// # Errors
/// [`DecompositionError`] when an entry is not finite or the iteration does not converge.
pub fn symmetric_eigen<T>(a: DMatrix<T>) -> Result<(DVector<f64>, DMatrix<T>), DecompositionError>
where
    T: ComplexField<RealField = f64>,
{
    let n = a.nrows();
    // nalgebra panics at an empty matrix.
    if n == 0 {
        return Ok((DVector::zeros(0), a));
    }
    if a.iter().any(|v| !v.is_finite()) {
        return Err(DecompositionError::NotFinite);
    }
    let eigen = SymmetricEigen::try_new(a, f64::EPSILON, SWEEPS * n.max(10))
        .ok_or(DecompositionError::NoConvergence { what: "eigenvalues" })?;
    if eigen.eigenvalues.iter().any(|v| !v.is_finite()) {
        return Err(DecompositionError::NotFinite);
    }
    Ok((eigen.eigenvalues, eigen.eigenvectors))
}
