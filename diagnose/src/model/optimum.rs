//! Outcome of a fit: what is kept of it, or why there is none.

use crate::model::noise::Profile;

/// Result of a fit without anything as long as the record: all that is kept of the many fits of a search.
#[derive(Debug, Clone)]
pub struct Optimum {
    /// Best values.
    pub values: Vec<f64>,
    /// Likelihood and noise model of the residual.
    pub profile: Profile,
}

/// Why a hypothesis has no prediction, or no estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// An effect does not fit the vehicle, or its parameters are not allowed.
    #[error("the effect is not applicable to the vehicle")]
    Inapplicable,
    /// The free run diverges.
    #[error("the free run diverges")]
    Diverged,
    /// The data do not determine what is sought.
    #[error("the record does not determine it")]
    NotDetermined,
}
