//! The continuous-time algebraic Riccati equation.

use nalgebra::DMatrix;
use whirlstand_linalg::{eigenvalues, solve_lyapunov, symmetric_part};

use super::pencil::{Scaled, compress, refine, stable_graph};
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
    let s = checked(a, b, q, r, s)?;
    let r_inverse = r.clone().cholesky().ok_or(RiccatiError::SingularInputWeight)?;
    let scaled = Scaled::new([a, b, q, r, &s], &extended(a, b, q, r, &s).abs());
    let (n, m) = b.shape();
    let h = extended(&scaled.a, &scaled.b, &scaled.q, &scaled.r, &scaled.s);
    let mut j = DMatrix::identity(2 * n + m, 2 * n + m);
    j.view_mut((2 * n, 2 * n), (m, m)).fill(0.0);
    let (h, j) = compress(&h, &j, m);
    let graph = stable_graph(&h, &j, |alpha, beta| {
        let size = beta.norm_sqr();
        let real = (alpha * beta.conj()).re;
        if size == 0.0 { f64::INFINITY.copysign(real) } else { real / size }
    })?;
    let x = symmetric_part(&scaled.unscale(&graph));
    let gain = |x: &DMatrix<f64>| r_inverse.solve(&(b.transpose() * x + s.transpose()));
    let (x, residual) = refine(
        x,
        |x| care_residual(a, b, q, r, Some(&s), x),
        |x| {
            let gain = gain(x);
            solve_lyapunov(&(a - b * &gain), &equation(a, b, q, &gain, &s, x)).ok()
        },
    );
    let gain = gain(&x);
    let poles = eigenvalues(&(a - b * &gain))?;
    let abscissa = poles.iter().map(|p| p.re).fold(f64::NEG_INFINITY, f64::max);
    if abscissa.is_nan() || abscissa >= 0.0 || !residual.is_finite() {
        return Err(RiccatiError::NoStabilisingSolution { measure: "real part", value: abscissa });
    }
    Ok(Riccati { x, gain, poles, relative_residual: residual })
}

/// The extended Hamiltonian matrix.
fn extended(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    s: &DMatrix<f64>,
) -> DMatrix<f64> {
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
    h
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
    symmetric_part(&(&ax + ax.transpose() - (x * b + s) * gain + q))
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
    let s = s.unwrap_or(&zero);
    let Some(gain) = r.clone().cholesky().map(|c| c.solve(&(b.transpose() * x + s.transpose()))) else {
        return f64::NAN;
    };
    let residual = equation(a, b, q, &gain, s, x).norm();
    if residual == 0.0 { 0.0 } else { residual / x.norm() }
}
