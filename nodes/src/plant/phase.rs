//! Where a plant is between its start and its end.

use std::time::Instant;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Phase {
    /// Waiting to hear that all peers run.
    Joining { until: Instant },
    /// Step 0 is out, command 0 awaited.
    Answering { until: Instant, repeat: Instant },
    /// In the loop.
    Looping,
    /// The last step is out; its command completes the log. A lockstep plant that was not asked to end waits for it.
    Ending { until: Option<Instant> },
    /// Over.
    Ended,
}
