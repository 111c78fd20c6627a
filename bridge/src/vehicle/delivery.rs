//! Follows each output until it has left its port: an output that was dropped by a full or closed line never
//! acts.

use std::time::Duration;

use super::{Port, Source, Vehicle};
use crate::config::Output;

/// Fate of the outputs.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Delivery {
    /// True while an output waits in the buffer of its port.
    waits: bool,
    /// True when the last output never left.
    lost: bool,
    /// Time since which no output has left.
    lost_since: Option<Duration>,
    /// True while the dedicated line of the outputs is closed.
    is_closed: bool,
}

impl Delivery {
    /// An output was written into the buffer of its port.
    pub(super) fn written(&mut self) {
        self.waits = true;
    }

    /// The outputs were handed over and none is sent, so that the state of the line is unknown.
    pub(super) fn released(&mut self) {
        (self.lost, self.lost_since) = (false, None);
    }

    /// True when the last output never left.
    pub(super) fn is_lost(&self) -> bool {
        self.lost
    }

    /// True while outputs can be sent: the line is open, and took one within `patience`.
    pub(super) fn is_possible(&self, patience: Duration, now: Duration) -> bool {
        !self.is_closed && self.lost_since.is_none_or(|since| now.saturating_sub(since) < patience)
    }
}

impl Vehicle {
    /// The port through which outputs leave.
    fn output_port(&self) -> Port {
        match self.output {
            Output::Crsf | Output::Sbus if matches!(self.source, Source::Mavlink(_)) => Port::Output,
            _ => Port::Link,
        }
    }

    /// Reports how many bytes of a port were taken, and whether they left it.
    pub fn handed_on(&mut self, port: Port, bytes: usize, has_left: bool, now: Duration) {
        let is_output = port == self.output_port() && std::mem::take(&mut self.delivery.waits);
        if port == Port::Link && has_left {
            self.ground.waiting.sent(bytes, is_output, now);
        }
        if !is_output {
            return;
        }
        self.delivery.lost = !has_left;
        if has_left {
            self.delivery.lost_since = None;
        } else {
            self.delivery.lost_since.get_or_insert(now);
            self.outputs = self.outputs.saturating_sub(1);
        }
    }

    /// Reports that a port was closed; [`Vehicle::connected`] that it is open again.
    pub fn closed(&mut self, port: Port) {
        self.set_closed(port, true);
    }

    /// A closed link to the vehicle shows by its silence.
    pub(super) fn set_closed(&mut self, port: Port, is_closed: bool) {
        if port == Port::Output {
            self.delivery.is_closed = is_closed;
        }
    }
}
