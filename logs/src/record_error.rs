//! Errors of records.

use whirlstand_msgs::names::did_you_mean;

use crate::mapping::{Unreadable, list};

/// The reason why a requested signal is not available.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SignalError {
    /// The record does not have it.
    #[error(
        "{origin} has no signal '{wanted}'{}. It has: {}. Use --map {wanted}=NAME[unit] to say which one it is.",
        did_you_mean(wanted, available.iter().map(String::as_str)),
        list(available)
    )]
    Missing {
        /// Where the record was read from.
        origin: String,
        /// The name.
        wanted: String,
        /// What the record has.
        available: Vec<String>,
    },
    /// The record has the signal, but it cannot be read.
    #[error(transparent)]
    Unreadable(Unreadable),
}

/// The reason why signals cannot form a record.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// Two signals have one name.
    #[error("{origin} would have two signals called '{name}'")]
    Duplicate {
        /// Where the record was read from.
        origin: String,
        /// The name.
        name: String,
    },
    /// A signal does not have one value per point of the time axis.
    #[error("signal '{name}' of {origin} has {found} values for {expected} points in time")]
    Length {
        /// Where the record was read from.
        origin: String,
        /// The name.
        name: String,
        /// Number of values.
        found: usize,
        /// Number of points in time.
        expected: usize,
    },
    /// The time axis does not increase.
    #[error("time of {origin} does not increase after point {index}, counted from 0")]
    Time {
        /// Where the record was read from.
        origin: String,
        /// Last point before the one that is not later.
        index: usize,
    },
}
