//! The commands of a record.

/// Commands of a record: one vector for each input, SI, held over each period.
#[derive(Debug, Clone, PartialEq)]
pub struct Commands {
    /// Period, s.
    pub period_s: f64,
    /// One vector for each input.
    pub inputs: Vec<Vec<f64>>,
}

impl Commands {
    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.inputs.first().map_or(0, Vec::len)
    }

    /// Length, s.
    pub fn duration_s(&self) -> f64 {
        self.samples() as f64 * self.period_s
    }
}
