//! The continuous-time algebraic Riccati equation.

use nalgebra::DMatrix;
use whirlstand_linalg::{C64, solve_lyapunov, symmetric_part};

use super::solve::{Data, Equation, relative_residual, solve};
use super::{Riccati, RiccatiError, checked};

/// Solves `A'X + XA - (XB + S) R^-1 (B'X + S') + Q = 0` for the stabilising X.
///
/// A is n x n, B n x m, Q n x n symmetric, R m x m symmetric positive definite, S n x m (none: zero). Needed:
/// (A, B) stabilisable and no unobservable mode of `(A - B R^-1 S', Q - S R^-1 S')` on the imaginary axis.
///
/// Method and sources: see the [module](super).
///
/// # Errors
/// [`RiccatiError`] for input that does not fit, a singular R, or when no stabilising solution exists.
///
/// ```
/// use nalgebra::dmatrix;
/// use whirlstand_control::riccati::care;
///
/// // The double integrator: X = [[sqrt(3), 1], [1, sqrt(3)]].
/// let (a, b) = (dmatrix![0.0, 1.0; 0.0, 0.0], dmatrix![0.0; 1.0]);
/// let solution = care(&a, &b, &dmatrix![1.0, 0.0; 0.0, 1.0], &dmatrix![1.0], None).unwrap();
/// assert!((solution.gain - dmatrix![1.0, 3f64.sqrt()]).norm() < 1e-12);
/// ```
pub fn care(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: Option<&DMatrix<f64>>,
) -> Result<Riccati, RiccatiError> {
    let s = &checked(a, b, q, r, s)?;
    if r.clone().cholesky().is_none() {
        return Err(RiccatiError::SingularInputWeight);
    }
    solve::<Continuous>(Data { a, b, q, r, s })
}

struct Continuous;

impl Equation for Continuous {
    const MEASURE: (&'static str, f64) = ("real part", 0.0);

    /// The extended Hamiltonian matrix.
    fn pencil(Data { a, b, q, r, s }: Data<'_>) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, m) = b.shape();
        let mut h = DMatrix::zeros(2 * n + m, 2 * n + m);
        h.view_mut((0, 0), (n, n)).copy_from(a);
        h.view_mut((0, 2 * n), (n, m)).copy_from(b);
        h.view_mut((n, 0), (n, n)).copy_from(&-q);
        h.view_mut((n, n), (n, n)).copy_from(&-a.transpose());
        h.view_mut((n, 2 * n), (n, m)).copy_from(&-s);
        h.view_mut((2 * n, 0), (m, n)).copy_from(&s.transpose());
        h.view_mut((2 * n, n), (m, n)).copy_from(&b.transpose());
        h.view_mut((2 * n, 2 * n), (m, m)).copy_from(r);
        let mut j = DMatrix::identity(2 * n + m, 2 * n + m);
        j.view_mut((2 * n, 2 * n), (m, m)).fill(0.0);
        (h, j)
    }

    fn rank(alpha: C64, beta: C64) -> f64 {
        let size = beta.norm_sqr();
        let real = (alpha * beta.conj()).re;
        if size == 0.0 { f64::INFINITY.copysign(real) } else { real / size }
    }

    fn size(pole: &C64) -> f64 {
        pole.re
    }

    fn gain(Data { b, r, s, .. }: Data<'_>, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        Some(r.clone().cholesky()?.solve(&(b.transpose() * x + s.transpose())))
    }

    fn left_side(Data { a, b, q, s, .. }: Data<'_>, gain: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
        let ax = a.transpose() * x;
        symmetric_part(&(&ax + ax.transpose() - (x * b + s) * gain + q))
    }

    fn correction(closed: &DMatrix<f64>, left_side: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        solve_lyapunov(closed, left_side).ok()
    }
}

/// Frobenius norm of the equation's left side at `x` over that of `x`; NaN when R is singular.
pub fn care_residual(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: Option<&DMatrix<f64>>,
    x: &DMatrix<f64>,
) -> f64 {
    let zero = DMatrix::zeros(b.nrows(), b.ncols());
    relative_residual::<Continuous>(Data { a, b, q, r, s: s.unwrap_or(&zero) }, x)
}
