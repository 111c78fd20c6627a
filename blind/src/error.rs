//! Reasons why a trial cannot be made.

/// Reason why a trial cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BlindError {
    /// An effect, or the vehicle that it names, does not fit the experiment.
    #[error("{0}")]
    Effect(String),
    /// Without declared noise, detectability is not defined.
    #[error(
        "the vehicle '{vehicle}' declares no noise for its output '{output}', but blind trials need the noise of every sensor: add noise = ... to [[outputs]]"
    )]
    NoNoise {
        /// Name of the vehicle.
        vehicle: String,
        /// Name of its output.
        output: String,
    },
    /// The simulated motion diverges.
    #[error("the simulation of the vehicle diverges at {at_s:.2} s under this excitation")]
    Diverged {
        /// Time of the divergence, s.
        at_s: f64,
    },
}

impl BlindError {
    pub(crate) fn effect(error: impl std::fmt::Display) -> Self {
        Self::Effect(error.to_string())
    }
}
