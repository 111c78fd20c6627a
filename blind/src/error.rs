//! Why a trial cannot be made.

/// Why a trial cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BlindError {
    /// An effect, or the vehicle that it names, does not fit.
    #[error("{0}")]
    Effect(String),
    /// Without noise there is no detectability.
    #[error(
        "the vehicle '{vehicle}' declares no noise for its output '{output}', but blind trials need the noise of every sensor: add noise = ... to [[outputs]]"
    )]
    NoNoise {
        /// The vehicle.
        vehicle: String,
        /// Its output.
        output: String,
    },
    /// The motion left all bounds.
    #[error("the simulation of the vehicle diverges at {at_s:.2} s under this excitation")]
    Diverged {
        /// When, s.
        at_s: f64,
    },
}

impl BlindError {
    pub(crate) fn effect(error: impl std::fmt::Display) -> Self {
        Self::Effect(error.to_string())
    }
}
