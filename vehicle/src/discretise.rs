//! The matrix exponential, and its integrals over one sample period: zero-order-hold discretisation and the Gramian of a
//! finite horizon, both by [`crate::doubling`].

use nalgebra::DMatrix;

use crate::doubling::{Balanced, Transition};

/// Largest 1-norm of A times the period, and of a matrix whose exponential is computed: its tenth power, from
/// which the number of squarings follows, must not overflow.
const LARGEST_NORM: f64 = 1e30;

/// Reason why a matrix exponential cannot be computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DiscretiseError {
    /// An entry of a matrix, or of the result, is not finite.
    #[error("the matrix exponential over one period is not finite")]
    NotFinite,
    /// The matrices have incompatible shapes.
    #[error("A must be square and B must have as many rows")]
    Shape,
}

/// Transition and input matrix of dx/dt = A x + B u over `period_s` with u held: x+ = Phi x + Gamma u.
///
/// Both follow from a short step that is doubled, so A may be singular and stiff. The error is a few units in the
/// last place of the largest entry, in units that balance rows and columns of A, for any ratio of the slowest to the
/// fastest mode.
///
/// # Errors
/// [`DiscretiseError::Shape`] unless `a` is n x n and `b` n x m; [`DiscretiseError::NotFinite`] when an entry is
/// not finite or the exponential overflows.
pub fn discretise(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    period_s: f64,
) -> Result<(DMatrix<f64>, DMatrix<f64>), DiscretiseError> {
    let n = a.nrows();
    if a.ncols() != n || b.nrows() != n {
        return Err(DiscretiseError::Shape);
    }
    check_norm(a, period_s)?;
    let (phi, gamma) = Balanced::new(a, period_s).transition_and_input(b);
    Ok((finite(phi)?, finite(gamma)?))
}

/// The same as [`discretise`] over the period, bit for bit, then over its half, its quarter and so on, `count` in all.
///
/// # Errors
/// As [`discretise`].
pub fn discretise_halves(
    a: &DMatrix<f64>,
    b: &DMatrix<f64>,
    period_s: f64,
    count: u32,
) -> Result<Vec<Transition>, DiscretiseError> {
    let whole = discretise(a, b, period_s)?;
    if count <= 1 {
        return Ok(vec![whole]);
    }
    let halves = Balanced::with_halves(a, period_s, count - 1).transitions_and_inputs(b, count);
    let halves = halves.into_iter().skip(1).map(|(phi, gamma)| Ok((finite(phi)?, finite(gamma)?)));
    std::iter::once(Ok(whole)).chain(halves).collect()
}

/// The Gramian of a finite horizon, the integral of exp(A t) W exp(A' t) over t from 0 to `horizon_s`, n x n and
/// symmetric.
///
/// With W the density of white noise on the derivatives it is the covariance of the states after the horizon;
/// with A transposed and W a weight it is the cost of the states' free motion over it.
///
/// # Errors
/// [`DiscretiseError::Shape`] unless `a` and `w` are n x n; [`DiscretiseError::NotFinite`] when an entry is not finite
/// or the exponential overflows.
pub fn finite_horizon_gramian(
    a: &DMatrix<f64>,
    w: &DMatrix<f64>,
    horizon_s: f64,
) -> Result<DMatrix<f64>, DiscretiseError> {
    let n = a.nrows();
    if a.ncols() != n || w.shape() != (n, n) {
        return Err(DiscretiseError::Shape);
    }
    check_norm(a, horizon_s)?;
    finite(Balanced::new(a, horizon_s).gramian(w))
}

fn check_norm(a: &DMatrix<f64>, length_s: f64) -> Result<(), DiscretiseError> {
    let norm = one_norm(a) * length_s.abs();
    if norm <= LARGEST_NORM { Ok(()) } else { Err(DiscretiseError::NotFinite) }
}

/// Maximum column sum of magnitudes; NaN when an entry is.
fn one_norm(m: &DMatrix<f64>) -> f64 {
    m.column_iter().map(|c| c.lp_norm(1)).fold(0.0, |a: f64, b| if b <= a { a } else { b })
}

fn finite(m: DMatrix<f64>) -> Result<DMatrix<f64>, DiscretiseError> {
    if m.iter().all(|v| v.is_finite()) { Ok(m) } else { Err(DiscretiseError::NotFinite) }
}

/// exp(M), by nalgebra's scaling and squaring with Pade approximants up to [13/13] (Al-Mohy and Higham, "A new scaling
/// and squaring algorithm for the matrix exponential", SIAM J. Matrix Anal. Appl. 31, 2009). It scales by the norms of
/// powers, so that a model in mixed units costs no digits.
///
/// # Errors
/// [`DiscretiseError::Shape`] unless M is square, [`DiscretiseError::NotFinite`] when an entry of M or of the
/// result is not finite or the 1-norm of M is beyond 1e30.
pub fn matrix_exponential(m: &DMatrix<f64>) -> Result<DMatrix<f64>, DiscretiseError> {
    if m.nrows() != m.ncols() {
        return Err(DiscretiseError::Shape);
    }
    check_norm(m, 1.0)?;
    #[expect(clippy::disallowed_methods, reason = "the squarings are few, as the norm is bounded")]
    let exponential = m.exp();
    finite(exponential)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_are_scipys() {
        let table: serde_json::Value = serde_json::from_str(include_str!("../reference/expm.json")).unwrap();
        let cases = table["cases"].as_array().unwrap();
        assert!(cases.len() >= 10);
        let mut worst: (f64, String) = (0.0, String::new());
        for case in cases {
            let matrix = |key: &str| {
                let rows = case[key].as_array().unwrap();
                let entry = |i: usize, j: usize| rows[i][j].as_f64().unwrap();
                DMatrix::from_fn(rows.len(), rows[0].as_array().unwrap().len(), entry)
            };
            let (m, expected) = (matrix("m"), matrix("expm"));
            let found = matrix_exponential(&m).unwrap();
            let error = (&found - &expected).norm() / expected.norm();
            let tolerance = case["tolerance"].as_f64().unwrap();
            assert!(error <= tolerance, "{}: {error:e} > {tolerance:e}", case["name"]);
            if error > worst.0 {
                worst = (error, case["name"].to_string());
            }
        }
        println!("largest relative error {:e} for {}", worst.0, worst.1);
    }

    /// A slow, a fast and an unstable mode.
    #[test]
    fn halves_of_a_period_are_discretised_as_each_alone() {
        let a = DMatrix::from_row_slice(3, 3, &[-0.01, 2.0, 0.0, 0.0, -80.0, 5.0, 1.0, 0.0, 3.0]);
        let b = DMatrix::from_row_slice(3, 2, &[0.0, 1.0, 40.0, 0.0, -2.0, 0.5]);
        let halves = discretise_halves(&a, &b, 0.05, 14).unwrap();
        assert_eq!(halves.len(), 14);
        for (level, (phi, gamma)) in halves.iter().enumerate() {
            let (own, input) = discretise(&a, &b, 0.05 * 0.5f64.powi(level as i32)).unwrap();
            let apart = |a: &DMatrix<f64>, b: &DMatrix<f64>| (a - b).abs().max() / b.abs().max();
            assert!(apart(phi, &own) < 1e-13 && apart(gamma, &input) < 1e-13, "{level}");
        }
        // A vehicle whose nonlinear effect is off moves as one without it, to the last bit.
        assert_eq!(halves[0], discretise(&a, &b, 0.05).unwrap());
        assert!(discretise_halves(&a, &b, f64::NAN, 3).is_err());
    }

    #[test]
    fn double_integrator_in_closed_form() {
        let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, 0.0]);
        let b = DMatrix::from_row_slice(2, 1, &[0.0, 3.0]);
        let (phi, gamma) = discretise(&a, &b, 0.2).unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-16, "{a} {b}");
        close(phi[(0, 1)], 0.2);
        close(phi[(0, 0)], 1.0);
        close(gamma[(0, 0)], 3.0 * 0.02);
        assert!((gamma[(1, 0)] - 0.6).abs() < 2e-16);
    }

    #[test]
    fn what_has_no_exponential_is_refused() {
        let m = |v: f64| DMatrix::from_element(2, 2, v);
        assert_eq!(matrix_exponential(&m(f64::NAN)), Err(DiscretiseError::NotFinite));
        for beyond in [1e4, 1e200, f64::INFINITY] {
            assert_eq!(matrix_exponential(&m(beyond)), Err(DiscretiseError::NotFinite));
        }
        assert_eq!(matrix_exponential(&DMatrix::zeros(2, 3)), Err(DiscretiseError::Shape));
        assert_eq!(matrix_exponential(&m(0.0)).unwrap(), DMatrix::identity(2, 2));
    }

    #[test]
    fn gramians_of_an_integrator_and_of_a_lag_in_closed_form() {
        // White noise of density 1 on the acceleration of a double integrator.
        let a = DMatrix::from_row_slice(2, 2, &[0.0, 1.0, 0.0, 0.0]);
        let w = DMatrix::from_row_slice(2, 2, &[0.0, 0.0, 0.0, 1.0]);
        let t = 0.3f64;
        let expected = DMatrix::from_row_slice(2, 2, &[t.powi(3) / 3.0, t * t / 2.0, t * t / 2.0, t]);
        assert!((finite_horizon_gramian(&a, &w, t).unwrap() - expected).amax() < 1e-16);
        let lag = finite_horizon_gramian(&DMatrix::from_element(1, 1, -2.0), &DMatrix::identity(1, 1), t);
        assert!((lag.unwrap()[(0, 0)] - (1.0 - (-4.0 * t).exp()) / 4.0).abs() < 1e-15);
        let fast = finite_horizon_gramian(&DMatrix::from_element(1, 1, -1e4), &DMatrix::identity(1, 1), 1.0);
        assert!((fast.unwrap()[(0, 0)] - 0.5e-4).abs() < 1e-19);
        let unstable = DMatrix::from_element(1, 1, 1e4);
        let overflow = finite_horizon_gramian(&unstable, &DMatrix::identity(1, 1), 1.0);
        assert_eq!(overflow, Err(DiscretiseError::NotFinite));
    }

    proptest::proptest! {
        #[test]
        fn exponentials_multiply_and_discretisations_compose(
            entries in proptest::collection::vec(-3.0f64..3.0, 24),
            t in 0.001f64..2.0,
        ) {
            let (a, b) = (DMatrix::from_column_slice(4, 4, &entries[..16]), DMatrix::from_column_slice(4, 2, &entries[16..]));
            let whole = matrix_exponential(&(&a * t)).unwrap();
            let half = matrix_exponential(&(&a * (0.5 * t))).unwrap();
            proptest::prop_assert!((&half * &half - &whole).norm() <= 1e-11 * half.norm().powi(2));
            let (phi, gamma) = discretise(&a, &b, t).unwrap();
            let (phi2, gamma2) = discretise(&a, &b, 0.5 * t).unwrap();
            let size = phi2.norm() * gamma2.norm() + gamma2.norm();
            proptest::prop_assert!((&phi - &whole).norm() <= 1e-11 * half.norm().powi(2));
            proptest::prop_assert!((&phi2 * &gamma2 + &gamma2 - gamma).norm() <= 1e-11 * size.max(1e-300));
        }

        /// The sum over two halves of a horizon, and d/dt W(t) = A W + W A' + W(0) in its integrated form.
        #[test]
        fn gramians_add_up_and_solve_the_lyapunov_equation(
            entries in proptest::collection::vec(-1.0f64..1.0, 32),
            horizon_s in 0.001f64..1.0,
        ) {
            let a = DMatrix::from_column_slice(4, 4, &entries[..16]);
            let c = DMatrix::from_column_slice(4, 4, &entries[16..]);
            let w = &c * c.transpose();
            let whole = finite_horizon_gramian(&a, &w, horizon_s).unwrap();
            let half = finite_horizon_gramian(&a, &w, 0.5 * horizon_s).unwrap();
            let phi = matrix_exponential(&(&a * (0.5 * horizon_s))).unwrap();
            proptest::prop_assert!((&half + &phi * &half * phi.transpose() - &whole).norm() < 1e-13);
            let end = &phi * &phi;
            let gained = &end * &w * end.transpose() - &w;
            let equation = &a * &whole + &whole * a.transpose() - gained;
            proptest::prop_assert!(equation.norm() < 1e-12, "{:e}", equation.norm());
        }
    }
}
