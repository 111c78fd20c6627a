//! Whether an output of a real vehicle is rounded on its way, which no vehicle file says.
//!
//! Protocols round, such as CRSF to 1e-4 rad. How often a rounded value repeats depends on noise and motion, and
//! the actual noise is often several times smaller than declared, so a repeated value is no evidence there.

/// Number of differences in a row that must be multiples of one step. Continuous values pass once in
/// (2 [`TOLERANCE`])^-8 = 4e21 tries.
const IN_A_ROW: u32 = 8;

/// Largest deviation from a multiple, relative to the step: more than what numbers of 32 bits lose.
const TOLERANCE: f64 = 1e-3;

/// Largest step, relative to the declared noise, that counts as none: every number has a last digit.
const FINE: f64 = 1e-3;

/// The step of an output's values: the greatest common divisor of their differences.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Rounding {
    last: Option<f64>,
    step: f64,
    multiples: u32,
}

impl Rounding {
    /// Processes a value. Returns whether values with this noise are rounded.
    pub fn is_rounded(&mut self, y: f64, noise: f64) -> bool {
        let Some(last) = self.last.replace(y).filter(|last| last.is_finite() && y.is_finite()) else {
            return false;
        };
        let difference = (y - last).abs();
        if difference > 0.0 {
            let rest = if self.step > 0.0 {
                (difference - self.step * (difference / self.step).round()).abs()
            } else {
                difference
            };
            if self.step > 0.0 && rest <= TOLERANCE * self.step {
                self.multiples += 1;
            } else {
                (self.step, self.multiples) = (rest, 0);
            }
        }
        self.multiples >= IN_A_ROW && self.step > FINE * noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    #[test]
    fn rounded_values_are_told_from_continuous_ones() {
        let mut stream = Stream::new(1, "rounding");
        let values: Vec<f64> =
            (0..5000).map(|k| 0.3 * (0.1 * f64::from(k)).sin() + 1e-3 * stream.normal()).collect();
        let seen = |map: fn(f64) -> f64| {
            let mut rounding = Rounding::default();
            values.iter().position(|y| rounding.is_rounded(map(*y), 1e-3))
        };
        assert_eq!(seen(|y| y), None);
        assert_eq!(seen(|y| f64::from(y as f32)), None);
        assert!(seen(|y| (y * 1e4).round() * 1e-4).is_some_and(|k| k < 30));
        assert!(
            seen(|y| f64::from((y.to_degrees().round() * 0.1).to_radians() as f32)).is_some_and(|k| k < 30)
        );
        assert_eq!(seen(|_| f64::NAN), None);
    }
}
