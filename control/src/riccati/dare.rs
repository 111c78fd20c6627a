//! The discrete-time algebraic Riccati equation.

use nalgebra::DMatrix;
use whirlstand_linalg::{C64, solve_stein, symmetric_part};

use super::solve::{Data, Equation, relative_residual, solve};
use super::{Riccati, RiccatiError, checked};

/// Solves `A'XA - X - (A'XB + S)(R + B'XB)^-1 (B'XA + S') + Q = 0` for the stabilising X.
///
/// A is n x n and may be singular (delays make it so), B n x m, Q n x n symmetric, R m x m symmetric with
/// `R + B'XB` invertible, S n x m (none: zero). Needed: (A, B) stabilisable and no unobservable mode on the unit
/// circle.
///
/// Method and sources: see the [module](super).
///
/// # Errors
/// [`RiccatiError`] for input that does not fit, or when no stabilising solution exists.
pub fn dare(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: Option<&DMatrix<f64>>,
) -> Result<Riccati, RiccatiError> {
    let s = &checked(a, b, q, r, s)?;
    solve::<Discrete>(Data { a, b, q, r, s })
}

struct Discrete;

impl Equation for Discrete {
    const MEASURE: (&'static str, f64) = ("magnitude", 1.0);

    /// The extended symplectic pencil.
    fn pencil(Data { a, b, q, r, s }: Data<'_>) -> (DMatrix<f64>, DMatrix<f64>) {
        let (n, m) = b.shape();
        let size = 2 * n + m;
        let mut h = DMatrix::zeros(size, size);
        h.view_mut((0, 0), (n, n)).copy_from(a);
        h.view_mut((0, 2 * n), (n, m)).copy_from(b);
        h.view_mut((n, 0), (n, n)).copy_from(&-q);
        h.view_mut((n, n), (n, n)).fill_with_identity();
        h.view_mut((n, 2 * n), (n, m)).copy_from(&-s);
        h.view_mut((2 * n, 0), (m, n)).copy_from(&s.transpose());
        h.view_mut((2 * n, 2 * n), (m, m)).copy_from(r);
        let mut j = DMatrix::zeros(size, size);
        j.view_mut((0, 0), (n, n)).fill_with_identity();
        j.view_mut((n, n), (n, n)).copy_from(&a.transpose());
        j.view_mut((2 * n, n), (m, n)).copy_from(&-b.transpose());
        (h, j)
    }

    fn rank(alpha: C64, beta: C64) -> f64 {
        let (alpha, beta) = (alpha.norm(), beta.norm());
        (alpha - beta) / (alpha + beta)
    }

    fn size(pole: &C64) -> f64 {
        pole.norm()
    }

    fn gain(Data { a, b, r, s, .. }: Data<'_>, x: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let bx = b.transpose() * x;
        let weight = symmetric_part(&(r + &bx * b));
        let rhs = bx * a + s.transpose();
        match weight.clone().cholesky() {
            Some(c) => Some(c.solve(&rhs)),
            None => weight.lu().solve(&rhs),
        }
    }

    fn left_side(Data { a, b, q, s, .. }: Data<'_>, gain: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
        let ax = a.transpose() * x;
        symmetric_part(&(&ax * a - x - (&ax * b + s) * gain + q))
    }

    fn correction(closed: &DMatrix<f64>, left_side: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        solve_stein(closed, left_side).ok()
    }
}

/// Frobenius norm of the equation's left side at `x` over that of `x`; NaN when `R + B'XB` is singular.
pub fn dare_residual(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: Option<&DMatrix<f64>>,
    x: &DMatrix<f64>,
) -> f64 {
    let zero = DMatrix::zeros(b.nrows(), b.ncols());
    relative_residual::<Discrete>(Data { a, b, q, r, s: s.unwrap_or(&zero) }, x)
}
