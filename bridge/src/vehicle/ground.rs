//! State of the conversation with the ground station behind the bridge.

use crate::forward::Forward;
use crate::mavlink::Deframer;

/// State of the conversation with the station.
#[derive(Debug)]
pub(super) struct Ground {
    pub(super) deframer: Deframer,
    /// Permitted frames that wait for room on the vehicle's link.
    pub(super) waiting: Forward,
    /// Number of messages that would have moved the vehicle.
    pub(super) refused_controls: u64,
    /// Number of requests for other rates.
    pub(super) refused_rates: u64,
}

impl Ground {
    pub(super) fn new(waiting: Forward) -> Self {
        Self { deframer: Deframer::new(), waiting, refused_controls: 0, refused_rates: 0 }
    }
}
