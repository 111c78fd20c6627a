//! Measurement model of a filter.

use nalgebra::DMatrix;

/// Measurement model `y = c x + d u + noise`.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensors {
    /// Output matrix, p x n.
    pub c: DMatrix<f64>,
    /// Feed-through matrix, p x m.
    pub d: DMatrix<f64>,
    /// Standard deviation of the noise of each output, SI units, positive.
    pub std: Vec<f64>,
    /// Names of the outputs.
    pub names: Vec<String>,
}
