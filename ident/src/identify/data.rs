//! The data of an identification: stretches of records on an even grid, with the vehicle's signals.

use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use super::IdentifyError;
use crate::compare::grid::grid;
use crate::compare::{CompareError, CompareOptions};

/// A stretch of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Where the record was read from.
    pub origin: String,
    /// Time of the first step in the record, s.
    pub start_s: f64,
    /// Period, s.
    pub period_s: f64,
    /// Steps by inputs, row after row, within the vehicle's limits.
    pub inputs: Vec<f64>,
    /// Steps by outputs of the vehicle, row after row; NaN where there is no value or the output is not fitted.
    pub outputs: Vec<f64>,
    /// Number of steps.
    pub steps: usize,
}

impl Segment {
    /// Takes a part of a record: the vehicle's inputs and those of its outputs that the record has.
    ///
    /// # Errors
    /// When the record lacks an input, an output that the vehicle file says shall be fitted, or any output at all;
    /// when it is too short or has no clock.
    pub fn new(
        record: &Record,
        vehicle: &Vehicle,
        period_s: Option<f64>,
        (from_s, until_s): (Option<f64>, Option<f64>),
    ) -> Result<Self, IdentifyError> {
        for (name, _) in vehicle.fit.iter().filter(|(_, weight)| *weight > 0.0) {
            record.signal(name).map_err(CompareError::from)?;
        }
        let options = CompareOptions { period_s, from_s, until_s, ..CompareOptions::default() };
        let grid = grid(record, vehicle, &options)?;
        let (m, p, steps) = (vehicle.inputs.len(), vehicle.outputs.len(), grid.t.len());
        let mut inputs = grid.inputs;
        for row in inputs.chunks_exact_mut(m) {
            for (u, input) in row.iter_mut().zip(&vehicle.inputs) {
                *u = u.clamp(input.lower, input.upper);
            }
        }
        let mut outputs = vec![f64::NAN; steps * p];
        for (values, &i) in grid.measured.iter().zip(&grid.outputs) {
            if vehicle.fit_weight(&vehicle.outputs[i].name) > 0.0 {
                for (k, value) in values.iter().enumerate() {
                    outputs[k * p + i] = *value;
                }
            }
        }
        Ok(Self {
            origin: record.origin.clone(),
            start_s: grid.start_s,
            period_s: grid.period_s,
            inputs,
            outputs,
            steps,
        })
    }

    /// Measured values of output `i`, one a step.
    pub fn output(&self, i: usize, p: usize) -> Vec<f64> {
        self.outputs.iter().skip(i).step_by(p).copied().collect()
    }

    /// Time of a step in the record, s.
    pub fn time(&self, step: usize) -> f64 {
        self.start_s + step as f64 * self.period_s
    }
}

/// Outputs that at least one segment has.
pub fn present(segments: &[Segment], p: usize) -> Vec<bool> {
    (0..p)
        .map(|i| segments.iter().any(|s| s.outputs.iter().skip(i).step_by(p).any(|v| v.is_finite())))
        .collect()
}
