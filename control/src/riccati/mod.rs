//! Algebraic Riccati equations, continuous and discrete.
//!
//! Both are solved through the ordered generalised Schur form of the extended pencil (Van Dooren, SIAM J. Sci.
//! Stat. Comput. 2, 1981; Arnold and Laub, Proc. IEEE 72, 1984), which inverts neither `R` nor `A`. The problem
//! is scaled first by powers of two that keep its symplectic structure (Benner, Numer. Algorithms 28, 2001), and
//! the solution is polished by Newton steps in correction form (Kleinman, IEEE Trans. Autom. Control 13, 1968;
//! Hewer, ibid. 16, 1971) for as long as they lower the residual.

mod care;
mod dare;
mod pencil;
mod solve;

pub use care::{care, care_residual};
pub use dare::{dare, dare_residual};

use nalgebra::DMatrix;
use thiserror::Error;
use whirlstand_linalg::{C64, DecompositionError};

/// The stabilising solution of a Riccati equation.
#[derive(Debug, Clone, PartialEq)]
pub struct Riccati {
    /// The solution X, n x n, symmetric.
    pub x: DMatrix<f64>,
    /// The optimal gain K, m x n, of `u = -K x`.
    pub gain: DMatrix<f64>,
    /// Eigenvalues of `A - B K`.
    pub poles: Vec<C64>,
    /// Frobenius norm of the equation's residual over that of X.
    pub relative_residual: f64,
}

/// Reason why a Riccati equation was not solved.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RiccatiError {
    /// The matrices have incompatible shapes.
    #[error("{what} is {rows} x {columns}, but {wanted_rows} x {wanted_columns} is needed")]
    Shape {
        /// Name of the matrix.
        what: &'static str,
        /// Its number of rows.
        rows: usize,
        /// Its number of columns.
        columns: usize,
        /// Number of rows needed.
        wanted_rows: usize,
        /// Number of columns needed.
        wanted_columns: usize,
    },
    /// A matrix contains NaN or infinity.
    #[error("{what} has an entry that is not finite")]
    NotFinite {
        /// Name of the matrix.
        what: &'static str,
    },
    /// A weight that is not symmetric.
    #[error("{what} is not symmetric; weights have to be")]
    NotSymmetric {
        /// Name of the matrix.
        what: &'static str,
    },
    /// The input weight cannot be inverted.
    #[error("the input weight R is singular (continuous time needs R > 0, discrete time R + B'XB > 0)")]
    SingularInputWeight,
    /// There is no stabilising solution.
    #[error(
        "there is no stabilising solution: (A, B) has an uncontrollable mode that is not asymptotically stable, or the \
         weight Q does not see a mode on the stability boundary (largest closed-loop {measure} is {value:.6e})"
    )]
    NoStabilisingSolution {
        /// Measure of stability: `real part` or `magnitude`.
        measure: &'static str,
        /// Value of the measure.
        value: f64,
    },
    /// The eigenvalue iteration failed.
    #[error(transparent)]
    Eigenvalues(#[from] DecompositionError),
}

/// Checks shapes, finiteness and symmetry; returns the cross term, zero without one.
fn checked(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: Option<&DMatrix<f64>>,
) -> Result<DMatrix<f64>, RiccatiError> {
    let (n, m) = (a.nrows(), b.ncols());
    let zero = DMatrix::zeros(n, m);
    let cross = s.unwrap_or(&zero);
    for (what, matrix, wanted_rows, wanted_columns) in
        [("A", a, n, n), ("B", b, n, m), ("Q", q, n, n), ("R", r, m, m), ("S", cross, n, m)]
    {
        let (rows, columns) = matrix.shape();
        if (rows, columns) != (wanted_rows, wanted_columns) {
            return Err(RiccatiError::Shape { what, rows, columns, wanted_rows, wanted_columns });
        }
        if matrix.iter().any(|v| !v.is_finite()) {
            return Err(RiccatiError::NotFinite { what });
        }
    }
    for (what, matrix) in [("Q", q), ("R", r)] {
        if (matrix - matrix.transpose()).norm() > 100.0 * f64::EPSILON * matrix.norm() {
            return Err(RiccatiError::NotSymmetric { what });
        }
    }
    Ok(cross.clone())
}
