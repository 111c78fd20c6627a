//! Kinds of commands that a pilot or a test engineer would give.

use serde::{Deserialize, Serialize};

/// Kind of excitation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Excitation {
    /// A step to each side, one input after the other, again and again.
    Doublets,
    /// Steps of 3, 2, 1 and 1 units of time to alternating sides.
    Steps3211,
    /// Steps of drawn number, lengths and heights to alternating sides.
    Multisteps,
    /// Sine whose frequency rises or falls in its logarithm.
    Sweep,
    /// Sine whose frequency rises or falls in proportion to time.
    Chirp,
    /// Pseudo-random binary sequence: at every unit of time to one side or the other.
    Prbs,
    /// Band-limited random motion, as of a pilot's hand.
    Pilot,
    /// Given by the user.
    Given,
}

impl Excitation {
    /// Name, for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Doublets => "doublets",
            Self::Steps3211 => "3-2-1-1",
            Self::Multisteps => "multisteps",
            Self::Sweep => "sweep",
            Self::Chirp => "chirp",
            Self::Prbs => "PRBS",
            Self::Pilot => "pilot",
            Self::Given => "given",
        }
    }
}
