//! The kinds of excitation that a pilot or a test engineer would use.

use serde::{Deserialize, Serialize};

/// Kind of excitation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Excitation {
    /// Doublets (a step to each side), one input after the other, repeated.
    Doublets,
    /// Steps of 3, 2, 1 and 1 time units with alternating sign.
    Steps3211,
    /// Steps of random number, lengths and heights with alternating sign.
    Multisteps,
    /// Sine sweep whose frequency varies exponentially with time, upwards or downwards.
    Sweep,
    /// Sine sweep whose frequency varies linearly with time, upwards or downwards.
    Chirp,
    /// Pseudo-random binary sequence: the sign is chosen anew at every time unit.
    Prbs,
    /// Band-limited random commands, like those of a pilot.
    Pilot,
    /// Excitation given by the user.
    Given,
}

impl Excitation {
    /// Name of the excitation, for tables.
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
