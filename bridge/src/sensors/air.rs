//! The standard atmosphere below 11 km (ISO 2533:1975).

/// Standard gravity, m/s^2.
pub const STANDARD_GRAVITY: f64 = 9.80665;

/// Pressure at sea level, Pa.
const SEA_LEVEL_PRESSURE: f64 = 101_325.0;
/// Temperature at sea level, K.
const SEA_LEVEL_TEMPERATURE: f64 = 288.15;
/// Decrease of temperature with height, K/m.
const LAPSE: f64 = 0.0065;
/// Specific gas constant of dry air, J/(kg K).
const GAS: f64 = 287.052_87;
/// Exponent of pressure as a function of temperature.
const EXPONENT: f64 = STANDARD_GRAVITY / (LAPSE * GAS);

/// Temperature at a height above the sea in metres, K.
pub fn temperature(altitude: f64) -> f64 {
    // The formula is invalid above the troposphere; a bench does not fly there, and the result must remain
    // plausible.
    SEA_LEVEL_TEMPERATURE - LAPSE * altitude.clamp(-5_000.0, 11_000.0)
}

/// Static pressure at a height above the sea in metres, Pa.
pub fn pressure(altitude: f64) -> f64 {
    SEA_LEVEL_PRESSURE * (temperature(altitude) / SEA_LEVEL_TEMPERATURE).powf(EXPONENT)
}

/// Density at a height above the sea in metres, kg/m^3.
pub fn density(altitude: f64) -> f64 {
    pressure(altitude) / (GAS * temperature(altitude))
}

/// Pressure altitude: height above the sea at which the static pressure is as given in Pa, m.
pub(super) fn altitude(pressure: f64) -> f64 {
    let ratio = (pressure / SEA_LEVEL_PRESSURE).max(1e-3);
    SEA_LEVEL_TEMPERATURE / LAPSE * (1.0 - ratio.powf(1.0 / EXPONENT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_atmosphere_is_that_of_the_standard() {
        // ISO 2533, table 5: geopotential height, temperature, pressure, density.
        for (h, t, p, rho) in [
            (0.0, 288.15, 101_325.0, 1.225),
            (1_000.0, 281.65, 89_874.6, 1.11164),
            (5_000.0, 255.65, 54_019.9, 0.736116),
        ] {
            assert!((temperature(h) - t).abs() < 1e-9);
            assert!((pressure(h) - p).abs() < 0.1, "{h}: {}", pressure(h));
            assert!((density(h) / rho - 1.0).abs() < 1e-5, "{h}: {}", density(h));
            assert!((altitude(pressure(h)) - h).abs() < 1e-6);
        }
        assert!(pressure(f64::INFINITY) > 0.0 && altitude(-1.0).is_finite());
    }
}
