//! Commands of the last steps, as received by the estimator.

use whirlstand_msgs::{Command, Message};

/// Number of steps kept; more than any answer can be late without being a miss.
const LENGTH: usize = 64;

pub(super) struct History {
    commands: [Option<Command>; LENGTH],
    inputs: usize,
}

impl History {
    pub(super) fn new(inputs: usize) -> Self {
        Self { commands: [None; LENGTH], inputs }
    }

    pub(super) fn put(&mut self, command: &Command) {
        // Commands that the plant would refuse have no effect on the vehicle either.
        let n = self.inputs;
        if command.count as usize != n || command.u[..n].iter().any(|v| !v.is_finite()) {
            return;
        }
        let slot = &mut self.commands[command.head().step as usize % LENGTH];
        // Plant and estimator both use the first command of a step.
        if slot.is_none_or(|c| c.head.step != command.head.step) {
            *slot = Some(*command);
        }
    }

    pub(super) fn get(&self, step: u64) -> Option<&Command> {
        self.commands[step as usize % LENGTH].as_ref().filter(|c| c.head.step == step)
    }

    pub(super) fn clear(&mut self) {
        self.commands = [None; LENGTH];
    }
}

/// Number of steps without a measurement after which a filter restarts instead of predicting through the gap.
pub(super) const LONGEST_GAP: u64 = LENGTH as u64 / 2;
