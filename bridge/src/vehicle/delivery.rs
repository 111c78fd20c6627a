//! Follows each output until it has left its port: an output that was dropped by a full or closed line never
//! acts.

use std::time::Duration;

/// Fate of the outputs.
#[derive(Debug, Clone, Default)]
pub(super) struct Delivery {
    /// True while an output waits in the buffer of its port.
    waits: bool,
    /// True when the last output never left.
    lost: bool,
    /// Time since which no output has left.
    lost_since: Option<Duration>,
    /// True while the dedicated line of the outputs is closed.
    is_closed: bool,
    /// Inputs of the last output that left its port; empty while there is none.
    acted: Vec<f64>,
}

impl Delivery {
    /// An output was written into the buffer of its port.
    pub(super) fn written(&mut self) {
        self.waits = true;
    }

    /// The outputs were handed over and none is sent, so that the state of the line is unknown.
    pub(super) fn released(&mut self) {
        (self.lost, self.lost_since) = (false, None);
        self.acted.clear();
    }

    /// True when the last output never left.
    pub(super) fn is_lost(&self) -> bool {
        self.lost
    }

    /// True while outputs can be sent: the line is open, and took one within `patience`.
    pub(super) fn is_possible(&self, patience: Duration, now: Duration) -> bool {
        !self.is_closed && self.lost_since.is_none_or(|since| now.saturating_sub(since) < patience)
    }

    /// True once after an output was written: what the port does next tells its fate.
    pub(super) fn takes(&mut self) -> bool {
        std::mem::take(&mut self.waits)
    }

    /// The port let the output of these inputs leave, or dropped it.
    pub(super) fn handed_on(&mut self, inputs: &[f64], has_left: bool, now: Duration) {
        self.lost = !has_left;
        if has_left {
            self.lost_since = None;
            self.acted.clear();
            self.acted.extend_from_slice(inputs);
        } else {
            self.lost_since.get_or_insert(now);
        }
    }

    /// The inputs that act: a receiver holds the last output that reached it. Empty while none has.
    pub(super) fn acted(&self) -> &[f64] {
        &self.acted
    }

    /// The dedicated line of the outputs was closed, or is open again.
    pub(super) fn set_closed(&mut self, is_closed: bool) {
        self.is_closed = is_closed;
    }
}
