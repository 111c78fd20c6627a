//! The motion of a simulated run as it truly was, step by step.

use std::path::Path;

use whirlstand_logs::bench_log::wanted;
use whirlstand_logs::{BenchMessage, Log};
use whirlstand_vehicle::Vehicle;

use crate::run::RunError;

/// A flight, step by step; SI, row after row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Flight {
    /// The states, steps x states.
    pub states: Vec<f64>,
    /// The inputs in force, steps x inputs.
    pub inputs: Vec<f64>,
    /// What is wanted of each state, steps x states; NaN where nothing is.
    pub wanted: Vec<f64>,
}

impl Flight {
    /// Reads the truth of a run of `vehicle` from its log; without any, a flight of no steps. The log is of one start of the
    /// plant.
    ///
    /// # Errors
    /// [`RunError::Read`].
    pub fn open(path: &Path, vehicle: &Vehicle) -> Result<Self, RunError> {
        let (n, m) = (vehicle.states.len(), vehicle.inputs.len());
        let log = Log::open(path)?;
        let mut flight = Self::default();
        let (mut times, mut setpoints) = (Vec::new(), Vec::new());
        for message in log.bench_messages()? {
            match message? {
                BenchMessage::Truth(truth) => {
                    times.push(truth.head.stamp_ns);
                    flight.states.extend_from_slice(&truth.x[..n]);
                    flight.inputs.extend_from_slice(&truth.u[..m]);
                }
                BenchMessage::Setpoint(setpoint) => {
                    let mut states = wanted(&setpoint);
                    states.truncate(n);
                    setpoints.push((setpoint.head.stamp_ns, states));
                }
                _ => {}
            }
        }
        // A setpoint holds from message to message, the first one also before itself.
        let mut next = 1;
        for ns in times {
            while setpoints.get(next).is_some_and(|(from, _)| *from <= ns) {
                next += 1;
            }
            match setpoints.get(next - 1) {
                Some((_, states)) => flight.wanted.extend_from_slice(states),
                None => flight.wanted.extend(std::iter::repeat_n(f64::NAN, n)),
            }
        }
        Ok(flight)
    }
}
