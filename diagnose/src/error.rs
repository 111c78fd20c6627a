//! Errors for which a record cannot be diagnosed at all.

use whirlstand_logs::shown::clean;
use whirlstand_vehicle::SimulatorError;

use whirlstand_ident::compare::CompareError;
use whirlstand_ident::identify::IdentifyError;

/// Reason why there is no diagnosis. Problems of a record that can be read are part of the answer, not
/// errors.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The record lacks a signal that the vehicle needs, or has no clock.
    #[error(transparent)]
    Record(#[from] IdentifyError),
    /// A record could not be resampled onto a grid.
    #[error(transparent)]
    Grid(#[from] CompareError),
    /// The record has too few steps.
    #[error(
        "{origin} has {steps} steps, but at least {least} are needed to distinguish causes: give a longer record"
    )]
    TooShort {
        /// Path of the record.
        origin: String,
        /// Steps of the record.
        steps: usize,
        /// Smallest number of steps.
        least: usize,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// The records of one diagnosis have different periods.
    #[error(
        "the periods differ: {other} has {} s, {first} has {} s; give one with --period",
        clean(*other_s), clean(*first_s)
    )]
    Periods {
        /// Path of the first record.
        first: String,
        /// Period of the first record, s.
        first_s: f64,
        /// Path of the other record.
        other: String,
        /// Period of the other record, s.
        other_s: f64,
    },
    /// The records of one diagnosis show different outputs.
    #[error(
        "{first} and {other} have no output in common: diagnose them one by one, or give records of the same outputs"
    )]
    NothingShared {
        /// Paths of the first records.
        first: String,
        /// Path of the record that shares no output with them.
        other: String,
    },
}
