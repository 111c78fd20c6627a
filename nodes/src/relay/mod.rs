//! Relays: connect a controller that is no program of a bench, because it speaks UDP or ROS 2.
//!
//! A relay is a node of its own (`exec = ["whirlstand", "relay", ...]`). It forwards the messages of a step,
//! and publishes the answer on the bus as the command of that step.

pub mod ros2;
mod udp;

pub use udp::run_udp;

use whirlstand_bus::{Bus, Publisher};
use whirlstand_msgs::{Command, flags};

use crate::error::NodeError;

/// Queue length for messages from the bus.
const DEPTH: usize = 64;

/// Publishes commands on the bus: a repeated one with the same number, as the plant expects. A missing
/// command is not final, as it may still arrive.
struct Answers {
    commands: Publisher<Command>,
    last: Option<Command>,
}

impl Answers {
    fn open(bus: &Bus) -> Result<Self, NodeError> {
        Ok(Self { commands: bus.publisher()?, last: None })
    }

    fn send(&mut self, command: &Command) -> Result<(), NodeError> {
        match self.of(command.head.step) {
            Some(last) => self.commands.send_again(&last)?,
            None => {
                self.commands.send(command)?;
                self.last = Some(*command);
            }
        }
        Ok(())
    }

    /// The command already sent for a step.
    fn of(&self, step: u64) -> Option<Command> {
        self.last.filter(|last| last.head.step == step && last.flags & flags::WITHHELD == 0)
    }
}
