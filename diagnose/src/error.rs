//! Why a record cannot be diagnosed at all.

use whirlstand_logs::shown::clean;
use whirlstand_vehicle::SimulatorError;

use whirlstand_ident::compare::CompareError;
use whirlstand_ident::identify::IdentifyError;

/// Why there is no diagnosis. What is wrong with a record that can be read is an answer, not an error.
#[derive(Debug, thiserror::Error)]
pub enum DiagnoseError {
    /// The record lacks what the vehicle needs, or has no clock.
    #[error(transparent)]
    Record(#[from] IdentifyError),
    /// A record could not be brought onto a grid.
    #[error(transparent)]
    Grid(#[from] CompareError),
    /// Too few steps.
    #[error(
        "{origin} has {steps} steps, but at least {least} are needed to distinguish causes: give a longer record"
    )]
    TooShort {
        /// Where the record was read from.
        origin: String,
        /// Steps that it has.
        steps: usize,
        /// Steps that are needed.
        least: usize,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// Records of one diagnosis have different periods.
    #[error(
        "the periods differ: {other} has {} s, {first} has {} s; give one with --period",
        clean(*other_s), clean(*first_s)
    )]
    Periods {
        /// The first record.
        first: String,
        /// Its period, s.
        first_s: f64,
        /// Another record.
        other: String,
        /// Its period, s.
        other_s: f64,
    },
}
