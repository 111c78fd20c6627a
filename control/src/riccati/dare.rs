//! The discrete-time algebraic Riccati equation.

use nalgebra::DMatrix;
use whirlstand_linalg::{eigenvalues, solve_stein, symmetric_part};

use super::pencil::{Scaled, compress, refine, stable_graph};
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
    let s = checked(a, b, q, r, s)?;
    let (h, j) = extended(a, b, q, r, &s);
    let scaled = Scaled::new([a, b, q, r, &s], &(h.abs() + j.abs()));
    let (h, j) = extended(&scaled.a, &scaled.b, &scaled.q, &scaled.r, &scaled.s);
    let (h, j) = compress(&h, &j, b.ncols());
    let graph = stable_graph(&h, &j, |alpha, beta| {
        let (alpha, beta) = (alpha.norm(), beta.norm());
        (alpha - beta) / (alpha + beta)
    })?;
    let x = symmetric_part(&scaled.unscale(&graph));
    let (x, residual) = refine(
        x,
        |x| dare_residual(a, b, q, r, Some(&s), x),
        |x| {
            let gain = gain(a, b, r, &s, x)?;
            solve_stein(&(a - b * &gain), &equation(a, b, q, &gain, &s, x)).ok()
        },
    );
    let gain = gain(a, b, r, &s, &x).ok_or(RiccatiError::SingularInputWeight)?;
    let poles = eigenvalues(&(a - b * &gain))?;
    let radius = poles.iter().map(|p| p.norm()).fold(0.0, f64::max);
    if radius.is_nan() || radius >= 1.0 || !residual.is_finite() {
        return Err(RiccatiError::NoStabilisingSolution { measure: "magnitude", value: radius });
    }
    Ok(Riccati { x, gain, poles, relative_residual: residual })
}

/// The extended symplectic pencil.
fn extended(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: &DMatrix<f64>,
) -> (DMatrix<f64>, DMatrix<f64>) {
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

/// The gain that belongs to `x`; none when `R + B'XB` is singular.
fn gain(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: &DMatrix<f64>,
    x: &DMatrix<f64>,
) -> Option<DMatrix<f64>> {
    let bx = b.transpose() * x;
    let weight = symmetric_part(&(r + &bx * b));
    let rhs = bx * a + s.transpose();
    match weight.clone().cholesky() {
        Some(c) => Some(c.solve(&rhs)),
        None => weight.lu().solve(&rhs),
    }
}

/// Left side of the equation, given the gain that belongs to `x`.
fn equation(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    gain: &DMatrix<f64>,
    s: &DMatrix<f64>,
    x: &DMatrix<f64>,
) -> DMatrix<f64> {
    let ax = a.transpose() * x;
    symmetric_part(&(&ax * a - x - (&ax * b + s) * gain + q))
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
    let s = s.unwrap_or(&zero);
    let Some(gain) = gain(a, b, r, s, x) else { return f64::NAN };
    let residual = equation(a, b, q, &gain, s, x).norm();
    if residual == 0.0 { 0.0 } else { residual / x.norm() }
}
