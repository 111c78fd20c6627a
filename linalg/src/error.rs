//! Why there is no decomposition.

use thiserror::Error;

/// Why a matrix has no decomposition here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum DecompositionError {
    /// An entry of the matrix or of what came out is NaN or infinite.
    #[error("the matrix has an entry that is not finite, or so large that what follows from it is not")]
    NotFinite,
    /// The iteration did not converge within its limit.
    #[error("the iteration for its {what} did not converge; the matrix is badly scaled or singular")]
    NoConvergence {
        /// What was to be found.
        what: &'static str,
    },
}
