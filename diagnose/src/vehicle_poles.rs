//! The vehicle's own time constants.

use nalgebra::Schur;
use whirlstand_vehicle::Vehicle;

use crate::thresholds::SCHUR_ROUNDS;

/// One over the real parts' magnitudes of the vehicle's poles, s; none where they cannot be computed.
pub fn time_constants_s(vehicle: &Vehicle) -> Vec<f64> {
    let schur = Schur::try_new(vehicle.a.clone(), f64::EPSILON, SCHUR_ROUNDS);
    let poles = schur.map(|s| s.complex_eigenvalues());
    poles.iter().flat_map(|p| p.iter()).map(|p| 1.0 / p.re.abs()).filter(|t| t.is_finite()).collect()
}
