//! When an autopilot's flight of the bench begins, and which of its answers count.

use serde::{Deserialize, Serialize};

/// When the run begins.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Begin {
    /// When the autopilot's motors turn. Until then it sees the vehicle stand still where it starts.
    #[default]
    Armed,
    /// With the autopilot's first outputs.
    Linked,
}

/// Options of a flight of the bench by an autopilot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightOptions {
    /// When the run begins.
    pub begin: Begin,
    /// Oldest outputs that are obeyed, s of wall-clock time; older ones are a lost link.
    pub stale_s: f64,
    /// How long an autopilot that waits for its sensors may take to answer them, s of wall-clock time; after that the
    /// outputs before are held.
    pub answer_timeout_s: f64,
}

impl Default for FlightOptions {
    fn default() -> Self {
        Self { begin: Begin::Armed, stale_s: 0.25, answer_timeout_s: 0.1 }
    }
}
