//! `whirlstand bridge check`: checks each axis of a bridge, live and disarmed.

mod autopilot;
mod consent;
mod reaction;
mod sticks;
mod telemetry;
mod tilt;
mod vehicle;

use std::time::Duration;

pub use autopilot::check_autopilot;
pub use consent::Consent;
pub use vehicle::check_vehicle;

/// Options of a check.
#[derive(Debug, Clone)]
pub struct CheckOptions {
    /// Longest wait for the other end and for each axis.
    pub timeout: Duration,
    /// For a vehicle: also move the channels, with consent.
    pub outputs: bool,
    /// For an autopilot: endpoint of its telemetry; the usual one when absent.
    pub telemetry: Option<String>,
    /// For an autopilot: also arm it, and check that its outputs counteract a tilt.
    pub arm: bool,
}

/// A finding of the check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    /// An instruction to the user.
    Ask(String),
    /// Information for the user.
    Told(String),
    /// A passed check.
    Good(String),
    /// A failed check.
    Wrong(String),
    /// An inconclusive check.
    Unknown(String),
}
