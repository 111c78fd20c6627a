//! Flow control: a lockstep plant does not run away from the recorder.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Message, Progress};

use crate::error::NodeError;
use crate::ports::receive;
use crate::recorder::QUEUE_DEPTH;

/// Steps that may be on their way to the recorder. Half its queue, because a step's estimate and command can
/// come after the next step's measurement.
const WINDOW: u64 = QUEUE_DEPTH as u64 / 2;

/// Steps after which it is worth looking for news of the recorder.
const POLL_STEPS: u64 = WINDOW / 4;

/// Keeps count of how far the recorder has come.
pub(super) struct Pace {
    progress: Subscriber<Progress>,
    recorded: u64,
    /// Nobody waits for a recorder that was replaced until the new one says something.
    present: bool,
}

impl Pace {
    pub(super) fn open(bus: &Bus) -> Result<Self, NodeError> {
        Ok(Self { progress: bus.subscriber(QUEUE_DEPTH)?, recorded: 0, present: true })
    }

    /// The recorder is another process now; what was on its way to the one before is lost.
    pub(super) fn forget(&mut self) {
        self.present = false;
    }

    /// Whether step `step` may be published now: a recorder that lives has room for it.
    pub(super) fn may_go_on(&mut self, step: u64) -> Result<bool, NodeError> {
        if step.saturating_sub(self.recorded) < POLL_STEPS {
            return Ok(true);
        }
        let mut refused = 0;
        while let Some(p) = receive(&mut self.progress, &mut refused)? {
            // A recorder that has written nothing yet has just come; it owes nothing from before.
            self.recorded = if p.written == 0 { step } else { p.head().step };
            self.present = true;
        }
        Ok(!self.present || step.saturating_sub(self.recorded) <= WINDOW)
    }
}
