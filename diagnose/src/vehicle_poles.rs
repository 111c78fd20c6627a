//! The vehicle's own time constants.

use whirlstand_vehicle::Vehicle;

/// Time constants of the vehicle's poles, one over the magnitudes of their real parts, s; empty where the
/// poles cannot be computed.
pub fn time_constants_s(vehicle: &Vehicle) -> Vec<f64> {
    vehicle.poles().iter().flatten().map(|p| 1.0 / p.re.abs()).filter(|t| t.is_finite()).collect()
}
