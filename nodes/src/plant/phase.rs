//! Phases of a plant's run.

use std::time::Instant;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Phase {
    /// Waiting until all peers are running.
    Joining { until: Instant },
    /// Step 0 is published, command 0 awaited.
    Answering { until: Instant, repeat: Instant },
    /// In the loop.
    Looping,
    /// The last step is published; its command completes the log. A lockstep plant that was not asked to end
    /// waits for it.
    Ending { until: Option<Instant> },
    /// The run is over.
    Ended,
}
