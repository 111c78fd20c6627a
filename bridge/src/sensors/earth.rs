//! Location of the bench on earth: the origin of positions, and the magnetic field.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::quantity;

/// Equatorial radius of WGS 84, m.
const EQUATOR: f64 = 6_378_137.0;
/// First eccentricity of WGS 84, squared.
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_14e-3;

/// Origin of positions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Latitude, degrees north.
    pub latitude_deg: f64,
    /// Longitude, degrees east.
    pub longitude_deg: f64,
    /// Height above the sea, m.
    pub altitude_m: f64,
}

impl Default for Origin {
    /// Irchel park in Zurich, also the start of PX4's simulators.
    fn default() -> Self {
        Self { latitude_deg: 47.397_742, longitude_deg: 8.545_594, altitude_m: 488.0 }
    }
}

impl Origin {
    /// Latitude and longitude in degrees of a point `north` and `east` of the origin, m, on the plane tangent
    /// to the ellipsoid WGS 84 at the origin.
    pub fn degrees(&self, north: f64, east: f64) -> (f64, f64) {
        let (sin, cos) = self.latitude_deg.to_radians().sin_cos();
        let w = 1.0 - ECCENTRICITY_SQUARED * sin * sin;
        let meridian = EQUATOR * (1.0 - ECCENTRICITY_SQUARED) / (w * w.sqrt());
        let parallel = EQUATOR / w.sqrt() * cos.max(1e-9);
        (
            self.latitude_deg + (north / meridian).to_degrees(),
            self.longitude_deg + (east / parallel).to_degrees(),
        )
    }
}

/// The earth's magnetic field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Field {
    /// Strength, T.
    pub strength: f64,
    /// Inclination below the horizon, rad.
    #[serde(deserialize_with = "quantity::angle")]
    pub inclination: f64,
    /// Declination of the horizontal part from north over east, rad.
    #[serde(deserialize_with = "quantity::angle")]
    pub declination: f64,
}

impl Default for Field {
    /// The field in Zurich by the World Magnetic Model for 2025: 48.5 uT, 63.4 degrees down, 3.4 degrees east.
    fn default() -> Self {
        Self { strength: 48.5e-6, inclination: 63.4f64.to_radians(), declination: 3.4f64.to_radians() }
    }
}

impl Field {
    /// The magnetic field, T, NED.
    pub fn ned(&self) -> Vector3<f64> {
        let (down, level) = self.inclination.sin_cos();
        let (east, north) = self.declination.sin_cos();
        self.strength * Vector3::new(level * north, level * east, down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minute_of_latitude_is_a_nautical_mile() {
        // Length of a degree of latitude and longitude at 45 degrees on WGS 84: 111 131.745 m and 78 846.81 m (NGA).
        let origin = Origin { latitude_deg: 45.0, longitude_deg: 0.0, altitude_m: 0.0 };
        let (latitude, longitude) = origin.degrees(1_111.317_45, -788.468_1);
        assert!((latitude - 45.01).abs() < 1e-7, "{latitude}");
        assert!((longitude + 0.01).abs() < 1e-7, "{longitude}");
    }

    #[test]
    fn the_field_points_north_and_into_the_ground_of_the_northern_hemisphere() {
        let field = Field::default().ned();
        assert!(field.x > 2e-5 && field.z > 4e-5 && field.y > 0.0 && field.y < 2e-6, "{field}");
        assert!((field.norm() - 48.5e-6).abs() < 1e-12);
    }
}
