//! Reference and stick over time.

use whirlstand_msgs::{Head, Message, Setpoint};
use whirlstand_vehicle::Vehicle;

use crate::config::{NodeConfig, SignalChange};
use crate::error::NodeError;
use crate::setup::step_at;

/// A value that changes at a step.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Change {
    step: u64,
    index: usize,
    value: f64,
}

/// Time-ordered changes of a set of signals, read forwards.
#[derive(Debug, Clone)]
struct Track {
    changes: Vec<Change>,
    next: usize,
}

impl Track {
    fn new(field: &str, changes: &[SignalChange], period_ns: u64, names: &[&str]) -> Result<Self, NodeError> {
        let mut list = Vec::new();
        for change in changes {
            for (name, &value) in &change.values {
                let index = names.iter().position(|n| n == name).ok_or_else(|| NodeError::Config {
                    field: format!("{field}.{name}"),
                    value: value.to_string(),
                    reason: format!("the vehicle has no such signal; it has {}", names.join(", ")),
                })?;
                list.push(Change { step: step_at(change.at_s, period_ns), index, value });
            }
        }
        Ok(Self { changes: list, next: 0 })
    }

    /// Applies the changes up to `step`.
    fn advance(&mut self, step: u64, values: &mut [f64]) {
        while let Some(change) = self.changes.get(self.next).filter(|c| c.step <= step) {
            values[change.index] = change.value;
            self.next += 1;
        }
    }
}

/// Reference and stick of the run, step by step.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    reference: Track,
    stick: Track,
    setpoint: Setpoint,
}

impl Profile {
    pub(crate) fn new(config: &NodeConfig, vehicle: &Vehicle) -> Result<Self, NodeError> {
        let states = vehicle.states.iter().map(|s| s.name.as_str()).collect::<Vec<_>>();
        let inputs = vehicle.inputs.iter().map(|i| i.name.as_str()).collect::<Vec<_>>();
        let reference = Track::new("setpoint", &config.setpoint, config.period_ns, &states)?;
        let tracked = reference.changes.iter().fold(0, |bits, c| bits | 1 << c.index);
        let stick = Track::new("stick", &config.stick, config.period_ns, &inputs)?;
        Ok(Self { reference, stick, setpoint: Setpoint { tracked, ..Setpoint::zeroed() } })
    }

    /// Reference, stick and the states that the profile ever sets, at a step not before the last one
    /// requested.
    pub(crate) fn at(&mut self, head: Head) -> &Setpoint {
        self.setpoint.head = head;
        self.reference.advance(head.step, &mut self.setpoint.x);
        self.stick.advance(head.step, &mut self.setpoint.stick);
        &self.setpoint
    }

    /// Restarts at step 0.
    pub(super) fn rewind(&mut self) {
        (self.reference.next, self.stick.next) = (0, 0);
        self.setpoint = Setpoint { tracked: self.setpoint.tracked, ..Setpoint::zeroed() };
    }
}
