//! Result of a step of a law.

/// Result of one step of a law besides the command.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Outcome {
    /// At least one input is at a limit of value or rate.
    pub saturated: bool,
    /// The estimate was not usable (NaN, infinite or of the wrong length); the last command is held, and after
    /// a few such steps the command is neutral.
    pub estimate_refused: bool,
    /// The reference was not usable; the last usable one is kept.
    pub reference_refused: bool,
}
