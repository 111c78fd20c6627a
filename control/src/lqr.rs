//! The linear-quadratic regulator, continuous, discrete and sampled.

use nalgebra::DMatrix;
use whirlstand_vehicle::{DiscretiseError, finite_horizon_gramian};

use crate::riccati::{Riccati, RiccatiError, care};

/// Gain of `u = -K x` that minimises the integral of `x'Qx + u'Ru` along `x' = Ax + Bu`. A is n x n, B n x m, Q
/// n x n, R m x m.
///
/// # Errors
/// As [`care`].
pub fn lqr(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
) -> Result<Riccati, RiccatiError> {
    care(a, b, q, r, None)
}

/// A continuous cost over one period with a held input, as a discrete cost `x'Qx + u'Ru + 2 x'Su`.
#[derive(Debug, Clone, PartialEq)]
pub struct SampledCost {
    /// State weight, n x n.
    pub q: DMatrix<f64>,
    /// Input weight, m x m.
    pub r: DMatrix<f64>,
    /// Cross weight, n x m.
    pub s: DMatrix<f64>,
}

/// The exact discrete equivalent of the cost rate `x'Qx + u'Ru` along `x' = Ax + Bu` with u held for `dt` s
/// (Van Loan, IEEE Trans. Autom. Control 23, 1978). The regulator for it minimises the continuous cost at any
/// sampling period.
///
/// # Errors
/// [`DiscretiseError`] when an unstable mode of the plant is too fast for the period.
pub fn sampled_cost(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    dt: f64,
) -> Result<SampledCost, DiscretiseError> {
    let (n, m) = b.shape();
    let size = n + m;
    let mut f = DMatrix::zeros(size, size);
    f.view_mut((0, 0), (n, n)).copy_from(a);
    f.view_mut((0, n), (n, m)).copy_from(b);
    let mut weight = DMatrix::zeros(size, size);
    weight.view_mut((0, 0), (n, n)).copy_from(q);
    weight.view_mut((n, n), (m, m)).copy_from(r);
    let cost = finite_horizon_gramian(&f.transpose(), &weight, dt)?;
    Ok(SampledCost {
        q: cost.view((0, 0), (n, n)).into_owned(),
        r: cost.view((n, n), (m, m)).into_owned(),
        s: cost.view((0, n), (n, m)).into_owned(),
    })
}
