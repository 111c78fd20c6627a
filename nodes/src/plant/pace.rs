//! Flow control: a lockstep plant does not run away from the recorder.

use whirlstand_bus::{Bus, Subscriber, Transport};
use whirlstand_msgs::{Message, Progress};

use crate::error::NodeError;
use crate::ports::receive;
use crate::recorder::QUEUE_DEPTH;

/// Steps that may be on their way to the recorder. Half its queue, because a step's estimate and command can
/// come after the next step's measurement.
const WINDOW: u64 = QUEUE_DEPTH as u64 / 2;

/// The same over a network, where what a recorder that stands still has not read waits in the buffers of its sockets: with
/// less than 1 kB of each sender and step it is less than Linux gives a socket at first (`tcp_wmem`, `tcp_rmem`).
const NETWORK_WINDOW: u64 = 32;

/// Keeps count of how far the recorder has come.
pub(super) struct Pace {
    progress: Subscriber<Progress>,
    window: u64,
    recorded: u64,
    /// Nobody waits for a recorder that was replaced until the new one says something.
    present: bool,
}

impl Pace {
    pub(super) fn open(bus: &Bus, transport: Transport) -> Result<Self, NodeError> {
        let window = if transport == Transport::Zenoh { NETWORK_WINDOW } else { WINDOW };
        Ok(Self { progress: bus.subscriber(QUEUE_DEPTH)?, window, recorded: 0, present: true })
    }

    /// The recorder is another process now; what was on its way to the one before is lost.
    pub(super) fn forget(&mut self) {
        self.present = false;
    }

    /// Whether step `step` may be published now: a recorder that lives has room for it.
    pub(super) fn may_go_on(&mut self, step: u64) -> Result<bool, NodeError> {
        // It is not worth looking for news at every step.
        if step.saturating_sub(self.recorded) < self.window / 4 {
            return Ok(true);
        }
        let mut refused = 0;
        while let Some(p) = receive(&mut self.progress, &mut refused)? {
            // A recorder that has written nothing yet has just come; it owes nothing from before.
            self.recorded = if p.written == 0 { step } else { p.head().step };
            self.present = true;
        }
        Ok(!self.present || step.saturating_sub(self.recorded) <= self.window)
    }
}
