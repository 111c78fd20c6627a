//! Limits of the inputs.

use serde::Serialize;

/// Limits of one actuator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct InputLimits {
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Largest rate of change, 1/s; infinite for none.
    pub rate: f64,
}

impl InputLimits {
    /// An input without limits.
    pub const NONE: Self = Self { lower: f64::NEG_INFINITY, upper: f64::INFINITY, rate: f64::INFINITY };

    /// The smaller distance from neutral (zero) to a limit; one for an unlimited input.
    pub fn authority(&self) -> f64 {
        let reach = self.upper.min(-self.lower);
        if reach.is_finite() && reach > 0.0 { reach } else { 1.0 }
    }
}
