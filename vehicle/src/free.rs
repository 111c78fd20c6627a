//! What identification may change: free matrix entries and free parameters of effects, and where a fit came from.

use crate::effects::{Effect, Matrix};

/// What a free parameter stands for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// Entry of a matrix: matrix, row and column from 0.
    Entry(Matrix, usize, usize),
    /// Parameter of an effect: index in [`Vehicle::effects`] and the parameter's name.
    Effect(usize, &'static str),
}

/// A free parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Free {
    /// What it stands for.
    pub target: Target,
    /// Least value, SI.
    pub lower: f64,
    /// Greatest value, SI.
    pub upper: f64,
    /// Where the search starts, SI; `None` when the data shall give the start.
    pub start: Option<f64>,
}

/// Where a fitted vehicle comes from: key and value, in the order in which they are written.
pub type Provenance = Vec<(String, String)>;

/// Key of the provenance that says where the noise of the outputs comes from.
pub const SENSOR_NOISE: &str = "sensor_noise";
/// Its value for noise that was estimated from a record in which the vehicle moved.
pub const ESTIMATED_IN_MOTION: &str = "estimated from a record of the moving vehicle";

impl Effect {
    /// The range in which the table allows a parameter, SI.
    pub fn range(&self, name: &str) -> Option<(f64, f64)> {
        let parameter = self.kind().spec().parameters.iter().find(|p| p.name == name)?;
        Some((parameter.lower, parameter.upper))
    }
}
