//! Lyapunov and Stein equations by the Schur method.

use nalgebra::DMatrix;

use super::eigen::Schur;
use super::{C64, DecompositionError, complex, symmetric_part};

/// X of `a' X + X a + q = 0` (all n x n, q symmetric), by Bartels and Stewart (Comm. ACM 15, 1972) in complex
/// arithmetic. Defined when no two eigenvalues of `a` sum to zero; otherwise the result is not finite.
///
/// # Errors
/// [`DecompositionError`] when the Schur form of `a` cannot be computed.
pub fn solve_lyapunov(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<DMatrix<f64>, DecompositionError> {
    let Schur { u, s } = Schur::new(&complex(a))?;
    let n = a.nrows();
    // S^H Y + Y S = -C with Y = U^H X U: column by column, each a lower triangular system.
    let c = u.adjoint() * complex(q) * &u;
    let mut y = DMatrix::<C64>::zeros(n, n);
    for j in 0..n {
        let mut rhs = -c.column(j);
        for k in 0..j {
            let factor = s[(k, j)];
            rhs -= y.column(k) * factor;
        }
        for i in 0..n {
            let mut v = rhs[i];
            for k in 0..i {
                v -= s[(k, i)].conj() * y[(k, j)];
            }
            y[(i, j)] = v / (s[(i, i)].conj() + s[(j, j)]);
        }
    }
    Ok(symmetric_part(&(&u * y * u.adjoint()).map(|v| v.re)))
}

/// X of `a' X a - X + q = 0` (all n x n, q symmetric), by the Schur method of Kitagawa (Int. J. Control 25,
/// 1977) in complex arithmetic. Defined when no product of two eigenvalues of `a` is one; otherwise the result
/// is not finite.
///
/// # Errors
/// [`DecompositionError`] when the Schur form of `a` cannot be computed.
pub fn solve_stein(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Result<DMatrix<f64>, DecompositionError> {
    let Schur { u, s } = Schur::new(&complex(a))?;
    let n = a.nrows();
    // S^H Y S - Y = -C. Column j: (s_jj S^H - I) y_j = -c_j - S^H sum_{k<j} s_kj y_k.
    let c = u.adjoint() * complex(q) * &u;
    let mut y = DMatrix::<C64>::zeros(n, n);
    for j in 0..n {
        let mut before = nalgebra::DVector::<C64>::zeros(n);
        for k in 0..j {
            before += y.column(k) * s[(k, j)];
        }
        let rhs = -c.column(j) - s.adjoint() * before;
        let sjj = s[(j, j)];
        for i in 0..n {
            let mut v = rhs[i];
            for k in 0..i {
                v -= sjj * s[(k, i)].conj() * y[(k, j)];
            }
            y[(i, j)] = v / (sjj * s[(i, i)].conj() - C64::new(1.0, 0.0));
        }
    }
    Ok(symmetric_part(&(&u * y * u.adjoint()).map(|v| v.re)))
}
