//! `whirlstand bridge check`: each axis of a bridge, live and disarmed.

mod autopilot;
mod reaction;
mod sticks;
mod tilt;
mod vehicle;

use std::time::Duration;

pub use autopilot::check_autopilot;
pub use vehicle::check_vehicle;

/// How to check.
#[derive(Debug, Clone)]
pub struct CheckOptions {
    /// How long to wait for the other end and for each axis.
    pub timeout: Duration,
    /// A vehicle: move the channels.
    pub outputs: bool,
    /// An autopilot: where its telemetry is heard; its usual place when absent.
    pub telemetry: Option<String>,
    /// An autopilot: arm it as well, and see that its outputs push back.
    pub arm: bool,
}

/// What was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Finding {
    /// Something that the user is to do.
    Ask(String),
    /// Something that the user should know.
    Told(String),
    /// Something is right.
    Good(String),
    /// Something is wrong.
    Wrong(String),
    /// Something cannot be told.
    Unknown(String),
}
