//! The true motion of a simulated run, step by step.

use whirlstand_logs::bench_log::wanted;
use whirlstand_msgs::Setpoint;

/// A flight, step by step; SI, row after row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Flight {
    /// The states, steps x states.
    pub states: Vec<f64>,
    /// The inputs in force, steps x inputs.
    pub inputs: Vec<f64>,
    /// Reference of each state, steps x states; NaN where a state is not tracked.
    pub wanted: Vec<f64>,
}

impl Flight {
    /// Appends a step: its states, the inputs in force and the setpoint.
    pub fn take(&mut self, x: &[f64], u: &[f64], setpoint: &Setpoint) {
        self.states.extend_from_slice(x);
        self.inputs.extend_from_slice(u);
        self.wanted.extend(wanted(setpoint).into_iter().take(x.len()));
    }
}
