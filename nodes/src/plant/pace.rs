//! Flow control: a lockstep plant does not run away from the recorder.

use std::time::{Duration, Instant};

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
    patience: Duration,
    recorded: u64,
    present: bool,
    waiting_since: Option<Instant>,
}

impl Pace {
    pub(super) fn open(bus: &Bus, patience: Duration) -> Result<Self, NodeError> {
        Ok(Self {
            progress: bus.subscriber(QUEUE_DEPTH)?,
            patience,
            recorded: 0,
            present: true,
            waiting_since: None,
        })
    }

    /// Whether step `step` may be published now. After waiting in vain the recorder counts as absent, and
    /// nobody waits for it until it says something again.
    pub(super) fn may_go_on(&mut self, step: u64, now: Instant) -> Result<bool, NodeError> {
        if step.saturating_sub(self.recorded) < POLL_STEPS {
            return Ok(true);
        }
        let mut refused = 0;
        while let Some(p) = receive(&mut self.progress, &mut refused)? {
            // A recorder that has written nothing yet has just come; it owes nothing from before.
            self.recorded = if p.written == 0 { step } else { p.head().step };
            self.present = true;
        }
        if !self.present || step.saturating_sub(self.recorded) <= WINDOW {
            self.waiting_since = None;
            return Ok(true);
        }
        if now.duration_since(*self.waiting_since.get_or_insert(now)) < self.patience {
            return Ok(false);
        }
        self.present = false;
        self.waiting_since = None;
        tracing::warn!(step, recorded = self.recorded, "the recorder does not keep up; going on without it");
        Ok(true)
    }
}
