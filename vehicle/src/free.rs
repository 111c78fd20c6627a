//! Free parameters for identification: matrix entries and parameters of effects, and the provenance of a fit.

use crate::effects::{Effect, Matrix};

/// Target of a free parameter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// Entry of a matrix: matrix, row and column from 0.
    Entry(Matrix, usize, usize),
    /// Parameter of an effect: index in `Vehicle::effects` and the parameter's name.
    Effect(usize, &'static str),
}

/// A free parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Free {
    /// Target of the parameter.
    pub target: Target,
    /// Lower bound, SI.
    pub lower: f64,
    /// Upper bound, SI.
    pub upper: f64,
    /// Start value of the search, SI; `None` when it follows from the data.
    pub start: Option<f64>,
}

/// Provenance of a fitted vehicle: keys and values, in the order in which they are written.
pub type Provenance = Vec<(String, String)>;

/// Key of the provenance for the steps of a fit that were longer than those of its record, s.
pub const FIT_PERIOD: &str = "period_s";

/// Key of the provenance for the source of the outputs' noise.
pub const SENSOR_NOISE: &str = "sensor_noise";
/// Value of [`SENSOR_NOISE`] for noise estimated from a record in which the vehicle moved.
pub const ESTIMATED_IN_MOTION: &str = "estimated from a record of the moving vehicle";

impl Effect {
    /// Valid range of a parameter according to the table, SI.
    pub fn range(&self, name: &str) -> Option<(f64, f64)> {
        let parameter = self.kind().spec().parameters.iter().find(|p| p.name == name)?;
        Some((parameter.lower, parameter.upper))
    }
}
