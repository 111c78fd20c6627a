//! The complex Schur form of a real matrix and its eigenvalues.

use nalgebra::DMatrix;

use super::qz::GeneralizedSchur;
use super::{C64, DecompositionError, balance, complex};

/// `A = U S U^H`, `U` unitary and `S` upper triangular.
#[derive(Debug, Clone)]
pub struct Schur {
    /// Unitary factor.
    pub u: DMatrix<C64>,
    /// Upper triangular factor.
    pub s: DMatrix<C64>,
}

impl Schur {
    /// Factorises the square matrix `a`.
    ///
    /// # Errors
    /// [`DecompositionError`] when an entry is not finite or the iteration does not converge.
    pub fn new(a: &DMatrix<C64>) -> Result<Self, DecompositionError> {
        let n = a.nrows();
        let f = GeneralizedSchur::new(a, &DMatrix::identity(n, n))?;
        // I = Q T Z^H with T triangular and unitary is diagonal, so A = Q (S T^-1) Q^H.
        let mut s = f.s;
        for j in 0..n {
            let inverse = f.t[(j, j)].conj();
            s.column_mut(j).iter_mut().for_each(|v| *v *= inverse);
        }
        Ok(Self { u: f.q, s })
    }
}

/// Eigenvalues of the real n x n matrix `a`, balanced first, by decreasing real part; conjugate pairs are
/// neighbours, positive imaginary part first.
///
/// # Errors
/// [`DecompositionError`] when an entry is not finite or the iteration does not converge.
pub fn eigenvalues(a: &DMatrix<f64>) -> Result<Vec<C64>, DecompositionError> {
    let n = a.nrows();
    if a.iter().any(|v| !v.is_finite()) {
        return Err(DecompositionError::NotFinite);
    }
    let balanced = balance(a);
    let schur = Schur::new(&complex(&balanced))?;
    let mut values: Vec<C64> = (0..n).map(|k| schur.s[(k, k)]).collect();
    pair_conjugates(&mut values, balanced.norm());
    values.sort_by(|x, y| {
        y.re.total_cmp(&x.re).then(x.im.abs().total_cmp(&y.im.abs())).then(y.im.total_cmp(&x.im))
    });
    Ok(values)
}

/// Makes the eigenvalues of a real matrix exactly closed under conjugation, which complex arithmetic achieves
/// only approximately.
fn pair_conjugates(values: &mut [C64], norm: f64) {
    let n = values.len();
    let mut done = vec![false; n];
    // Largest imaginary parts come first, so that a real eigenvalue is never taken as a partner.
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&i, &j| values[j].im.abs().total_cmp(&values[i].im.abs()));
    for &i in &order {
        if done[i] {
            continue;
        }
        done[i] = true;
        let v = values[i];
        let partner = (0..n)
            .filter(|&j| !done[j])
            .min_by(|&j, &k| (values[j].conj() - v).norm().total_cmp(&(values[k].conj() - v).norm()));
        match partner {
            Some(j) if (values[j].conj() - v).norm() < v.im.abs() => {
                let mean = (v + values[j].conj()) * 0.5;
                done[j] = true;
                values[i] = mean;
                values[j] = mean.conj();
            }
            _ if v.im.abs() <= 1e-6 * (norm + v.norm()) => values[i] = C64::new(v.re, 0.0),
            _ => {}
        }
    }
}

/// Largest real part of the eigenvalues of `a`: negative means that `x' = a x` is asymptotically stable.
///
/// # Errors
/// As [`eigenvalues`].
pub fn spectral_abscissa(a: &DMatrix<f64>) -> Result<f64, DecompositionError> {
    Ok(eigenvalues(a)?.iter().map(|v| v.re).fold(f64::NEG_INFINITY, f64::max))
}

/// Largest magnitude of the eigenvalues of `a`: below one means that `x+ = a x` is asymptotically stable.
///
/// # Errors
/// As [`eigenvalues`].
pub fn spectral_radius(a: &DMatrix<f64>) -> Result<f64, DecompositionError> {
    Ok(eigenvalues(a)?.iter().map(|v| v.norm()).fold(0.0, f64::max))
}
