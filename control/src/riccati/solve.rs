//! Common solver of both equations: from the pencil over its stable subspace to a refined solution.

use nalgebra::DMatrix;
use whirlstand_linalg::{C64, eigenvalues, symmetric_part};

use super::pencil::{Scaled, compress, refine, stable_graph};
use super::{Riccati, RiccatiError};

/// Matrices of an equation: A, B, Q, R, S.
#[derive(Clone, Copy)]
pub struct Data<'a> {
    pub a: &'a DMatrix<f64>,
    pub b: &'a DMatrix<f64>,
    pub q: &'a DMatrix<f64>,
    pub r: &'a DMatrix<f64>,
    pub s: &'a DMatrix<f64>,
}

/// Parts that differ between the two equations.
pub trait Equation {
    /// Measure of a pole's stability: its name, and its value at the stability boundary.
    const MEASURE: (&'static str, f64);

    /// The extended pencil, (2n + m) square.
    fn pencil(data: Data<'_>) -> (DMatrix<f64>, DMatrix<f64>);

    /// Sort key of an eigenvalue alpha / beta of the pencil; smaller is more stable.
    fn rank(alpha: C64, beta: C64) -> f64;

    /// Measure of a closed-loop pole, to be compared with [`Self::MEASURE`].
    fn size(pole: &C64) -> f64;

    /// The gain for `x`; none where the weight of the inputs is singular.
    fn gain(data: Data<'_>, x: &DMatrix<f64>) -> Option<DMatrix<f64>>;

    /// Left-hand side of the equation for `x` and its gain.
    fn left_side(data: Data<'_>, gain: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64>;

    /// Newton correction: solves the linear matrix equation of the closed loop.
    fn correction(closed: &DMatrix<f64>, left_side: &DMatrix<f64>) -> Option<DMatrix<f64>>;
}

/// Solves an equation with checked matrices.
pub fn solve<E: Equation>(data: Data<'_>) -> Result<Riccati, RiccatiError> {
    let Data { a, b, q, r, s } = data;
    let (h, j) = E::pencil(data);
    let scaled = Scaled::new([a, b, q, r, s], &(h.abs() + j.abs()));
    let (h, j) = E::pencil(Data { a: &scaled.a, b: &scaled.b, q: &scaled.q, r: &scaled.r, s: &scaled.s });
    let (h, j) = compress(&h, &j, b.ncols());
    let x = symmetric_part(&scaled.unscale(&stable_graph(&h, &j, E::rank)?));
    let correction = |x: &DMatrix<f64>| {
        let gain = E::gain(data, x)?;
        E::correction(&(a - b * &gain), &E::left_side(data, &gain, x))
    };
    let (x, residual) = refine(x, |x| relative_residual::<E>(data, x), correction);
    let gain = E::gain(data, &x).ok_or(RiccatiError::SingularInputWeight)?;
    let poles = eigenvalues(&(a - b * &gain))?;
    let (measure, boundary) = E::MEASURE;
    let value = poles.iter().map(E::size).fold(f64::NEG_INFINITY, f64::max);
    if value.is_nan() || value >= boundary || !residual.is_finite() {
        return Err(RiccatiError::NoStabilisingSolution { measure, value });
    }
    Ok(Riccati { x, gain, poles, relative_residual: residual })
}

/// Frobenius norm of the equation's left side at `x` over that of `x`; NaN where there is no gain.
pub fn relative_residual<E: Equation>(data: Data<'_>, x: &DMatrix<f64>) -> f64 {
    let Some(gain) = E::gain(data, x) else { return f64::NAN };
    let residual = E::left_side(data, &gain, x).norm();
    if residual == 0.0 { 0.0 } else { residual / x.norm() }
}
