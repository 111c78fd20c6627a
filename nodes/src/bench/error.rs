//! Errors of a measurement.

use super::options::MEASUREMENTS;
use crate::error::NodeError;

/// Reason why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The name of the measurement is unknown.
    #[error("there is no measurement \"{0}\"{hint}; there are {list}", hint = whirlstand_msgs::names::did_you_mean(.0, MEASUREMENTS), list = MEASUREMENTS.join(", "))]
    Unknown(String),
    /// A process cannot be started, or communication with it fails.
    #[error("{what}: {source}")]
    Process {
        /// Attempted action.
        what: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A process failed or sent something unexpected.
    #[error("{who} failed: {why}")]
    Member {
        /// Name of the process.
        who: String,
        /// Its error message.
        why: String,
    },
    /// A node in this process failed.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// A ring failed.
    #[error(transparent)]
    Ring(#[from] whirlstand_bus::ring::RingError),
}
