//! The vehicle's own time constants.

use whirlstand_vehicle::Vehicle;

/// One over the real parts' magnitudes of the vehicle's poles, s; none where they cannot be computed.
pub fn time_constants_s(vehicle: &Vehicle) -> Vec<f64> {
    vehicle.poles().iter().flatten().map(|p| 1.0 / p.re.abs()).filter(|t| t.is_finite()).collect()
}
