//! Errors of decompositions.

use thiserror::Error;

/// The reason why a decomposition failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum DecompositionError {
    /// An entry of the matrix or of the result is NaN or infinite.
    #[error("the matrix has an entry that is not finite, or so large that what follows from it is not")]
    NotFinite,
    /// The iteration did not converge within its limit.
    #[error("the iteration for its {what} did not converge; the matrix is badly scaled or singular")]
    NoConvergence {
        /// What the iteration was to find.
        what: &'static str,
    },
}
