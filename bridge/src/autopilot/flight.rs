//! Beginning of an autopilot's flight, and validity of its answers.

use serde::{Deserialize, Serialize};

/// Condition for the beginning of the run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Begin {
    /// The autopilot's motors turn. Until then its simulated vehicle is at rest at the start.
    #[default]
    Armed,
    /// The autopilot's first outputs arrive.
    Linked,
}

/// Options of a flight by an autopilot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlightOptions {
    /// Condition for the beginning of the run.
    pub begin: Begin,
    /// Largest age of outputs, s of wall-clock time; older ones mean a lost link.
    pub stale_s: f64,
    /// Longest time until an autopilot in lockstep answers its sensors, s of wall-clock time; after that the
    /// previous outputs are held.
    pub answer_timeout_s: f64,
}

impl Default for FlightOptions {
    fn default() -> Self {
        Self { begin: Begin::Armed, stale_s: 0.25, answer_timeout_s: 0.1 }
    }
}
