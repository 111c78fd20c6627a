//! Why a measurement fails.

use super::options::MEASUREMENTS;
use crate::error::NodeError;

/// Why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// There is no such measurement.
    #[error("there is no measurement \"{0}\"{hint}; there are {list}", hint = whirlstand_msgs::names::did_you_mean(.0, MEASUREMENTS), list = MEASUREMENTS.join(", "))]
    Unknown(String),
    /// A process cannot be started or talked to.
    #[error("{what}: {source}")]
    Process {
        /// What was tried.
        what: String,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A process ended badly or said something unexpected.
    #[error("{who} failed: {why}")]
    Member {
        /// Which process.
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
