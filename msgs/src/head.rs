//! Common header of all messages.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Common header of all messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Pod, Zeroable)]
#[repr(C)]
pub struct Head {
    /// Counts the messages of one publisher since it started, from 0; a gap is a lost message.
    pub seq: u64,
    /// Step k of the loop to which the message belongs.
    pub step: u64,
    /// Bench time of that step, t_k = k times the period, ns; wall-clock time for [`crate::Health`].
    pub stamp_ns: u64,
}
