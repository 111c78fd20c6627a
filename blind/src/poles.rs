//! Poles of drawn vehicles, by nalgebra's QR iteration with a limited number of sweeps. Where it does not
//! converge, a bound is used.

use nalgebra::{Complex, DMatrix, Dyn, OVector, Schur};

/// Largest number of sweeps of the QR iteration; about ten are usual for the sizes drawn here.
const SWEEPS: usize = 1000;

fn poles(a: &DMatrix<f64>) -> Option<OVector<Complex<f64>, Dyn>> {
    Schur::try_new(a.clone(), f64::EPSILON, SWEEPS).map(|schur| schur.complex_eigenvalues())
}

/// Largest magnitude of the poles of `a`, 1/s; where they are not found, the norm of `a`, which no pole
/// exceeds.
pub(crate) fn fastest(a: &DMatrix<f64>) -> f64 {
    poles(a).map_or_else(|| a.norm(), |p| p.iter().map(|p| p.norm()).fold(0.0, f64::max))
}

/// Largest real part of the poles of `a`, 1/s; where they are not found, the right edge of Gershgorin's
/// discs, which no pole exceeds.
pub(crate) fn rightmost(a: &DMatrix<f64>) -> f64 {
    let edge = |i: usize| a[(i, i)] + a.row(i).iter().map(|v| v.abs()).sum::<f64>() - a[(i, i)].abs();
    match poles(a) {
        Some(poles) => poles.iter().map(|p| p.re).fold(f64::MIN, f64::max),
        None => (0..a.nrows()).map(edge).fold(f64::MIN, f64::max),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_permutation_without_a_converging_iteration_is_bounded() {
        let cyclic = DMatrix::from_fn(6, 6, |i, j| f64::from(u8::from(j == (i + 1) % 6)));
        assert!((1.0..=2.5).contains(&fastest(&cyclic)) && (1.0..=2.5).contains(&rightmost(&cyclic)));
        let plain = DMatrix::from_row_slice(2, 2, &[-3.0, 1.0, 0.0, -1.0]);
        assert_eq!((fastest(&plain), rightmost(&plain)), (3.0, -1.0));
    }
}
