//! Reconstructs the inputs acting from each step on from received messages.
//!
//! The plant reports with each measurement what it applies from that step on: the command of the previous
//! step, the last one again ([`flags::HELD`]), or neutral ([`flags::FAILSAFE`]). A bridge to a vehicle
//! reports it with `Sent`.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Command, Imu, MAX_INPUTS, Sent, flags};

use crate::companion::Companion;
use crate::error::NodeError;
use crate::gate::InputLimits;
use crate::ports::receive;

/// Inputs acting from a step on.
pub(super) enum Acting {
    Known([f64; MAX_INPUTS]),
    /// The message that determines them has not arrived yet.
    Coming,
    /// The message that determines them was lost.
    Lost,
}

pub(super) struct Inputs {
    limits: InputLimits,
    commands: Subscriber<Command>,
    /// The next command, when it is for a later step than requested.
    next: Option<Command>,
    /// Messages of a bridge to a vehicle.
    sent: Option<Companion<Sent>>,
    /// Inputs in force; `None` while unknown.
    last: Option<[f64; MAX_INPUTS]>,
    before: Option<[f64; MAX_INPUTS]>,
}

impl Inputs {
    pub(super) fn open(bus: &Bus, limits: InputLimits, real: bool, depth: usize) -> Result<Self, NodeError> {
        Ok(Self {
            limits,
            commands: bus.subscriber(depth)?,
            next: None,
            sent: real.then(|| Companion::open(bus, true, depth)).transpose()?,
            last: None,
            before: None,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.limits.count
    }

    pub(super) fn restart(&mut self) {
        (self.last, self.before, self.next) = (None, None, None);
    }

    /// Inputs acting from the step of `imu` on. To be called once for each step, in order.
    pub(super) fn acting(&mut self, imu: &Imu, refused: &mut u64) -> Result<Acting, NodeError> {
        let step = imu.head.step;
        if let Some(sent) = &mut self.sent {
            sent.take(step, refused)?;
            let there = sent.has_reached(step).then(|| sent.at(step));
            return Ok(match there {
                None => Acting::Coming,
                Some(m) if m.head.step == step && has_acted(&m) => Acting::Known(m.u),
                Some(_) => Acting::Lost,
            });
        }
        let neutral = self.limits.neutral();
        let applied = if step == 0 || imu.flags & flags::FAILSAFE != 0 {
            Some(neutral)
        } else if imu.flags & flags::HELD != 0 {
            self.last
        } else {
            match self.command(step - 1, refused)? {
                Some(command) => self.usable(&command),
                None if self.next.is_none() => return Ok(Acting::Coming),
                None => None,
            }
        };
        self.before = std::mem::replace(&mut self.last, applied);
        Ok(applied.map_or(Acting::Lost, Acting::Known))
    }

    /// Undoes the last request, as the step will be requested again.
    pub(super) fn take_back(&mut self) {
        self.last = self.before;
    }

    /// The first command of a step; commands of earlier steps are discarded.
    fn command(&mut self, step: u64, refused: &mut u64) -> Result<Option<Command>, NodeError> {
        loop {
            let next = match self.next {
                Some(next) => next,
                None => match receive(&mut self.commands, refused)? {
                    Some(next) => *self.next.insert(next),
                    None => return Ok(None),
                },
            };
            if next.head.step > step {
                return Ok(None);
            }
            if next.head.step == step && self.usable(&next).is_some() {
                // It is kept until the next step is requested, so that the request can be repeated.
                return Ok(Some(next));
            }
            self.next = None;
        }
    }

    /// Inputs that the plant applies for a command; `None` for one that it refuses.
    fn usable(&self, command: &Command) -> Option<[f64; MAX_INPUTS]> {
        let count = self.limits.count;
        if command.count as usize != count || command.flags & flags::WITHHELD != 0 {
            return None;
        }
        let mut u = [0.0; MAX_INPUTS];
        for (i, to) in u.iter_mut().enumerate().take(count) {
            let value = command.u[i];
            if !value.is_finite() {
                return None;
            }
            *to = value.max(self.limits.lower[i]).min(self.limits.upper[i]);
        }
        Some(u)
    }

    pub(super) fn lost(&self) -> u64 {
        self.commands.lost() + self.sent.as_ref().map_or(0, Companion::lost)
    }
}

/// True when an output left the bridge; one that was dropped on its way has no inputs.
fn has_acted(sent: &Sent) -> bool {
    sent.count > 0 && sent.u.iter().take(sent.count as usize).all(|u| u.is_finite())
}
