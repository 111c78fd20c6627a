//! Errors of an identification.

use whirlstand_linalg::DecompositionError;
use whirlstand_logs::shown::clean;
use whirlstand_vehicle::SimulatorError;

use crate::compare::CompareError;

/// Reason why an identification cannot be made. No file was written.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// The vehicle file has no free parameter.
    #[error(
        "'{vehicle}' has no free parameter: add free = [{{ entry = \"A[2,1]\", lower = -10.0, upper = 10.0 }}, ...] to its file, or start from a template (quadrotor-structure, helicopter-structure)"
    )]
    NothingFree {
        /// Name of the vehicle.
        vehicle: String,
    },
    /// The record does not match the vehicle.
    #[error(transparent)]
    Record(#[from] CompareError),
    /// Two logs have different periods.
    #[error(
        "{first} has a period of {} s, {other} one of {} s: give --period SECONDS to resample both",
        clean(*first_s), clean(*other_s)
    )]
    Periods {
        /// Name of the first log.
        first: String,
        /// Period of the first log, s.
        first_s: f64,
        /// Name of the log with another period.
        other: String,
        /// Period of the other log, s.
        other_s: f64,
    },
    /// No input changes.
    #[error(
        "{origin}: no input of the vehicle changes between {} s and {} s ({inputs}): without excitation nothing can be identified; fly doublets or an input designed by `whirlstand excite`",
        clean(*from_s), clean(*until_s)
    )]
    NoExcitation {
        /// Path of the log.
        origin: String,
        /// Start of the part, s.
        from_s: f64,
        /// End of the part, s.
        until_s: f64,
        /// Names of the inputs.
        inputs: String,
    },
    /// Fewer samples than unknowns.
    #[error(
        "{samples} measured values cannot determine {unknowns} unknowns ({parameters} parameters, plus the initial state and offsets of each part): give a longer record or free fewer parameters"
    )]
    TooFew {
        /// Number of measured values.
        samples: usize,
        /// Number of unknowns.
        unknowns: usize,
        /// Number of parameters among the unknowns.
        parameters: usize,
    },
    /// The simulation diverges from every start.
    #[error(
        "the simulation diverges from every start ({tried} tried): give stable start values in the vehicle file (start = ...) or narrower bounds, or use --noise kalman, which needs no stable simulation"
    )]
    UnstableStart {
        /// Number of starts tried.
        tried: usize,
    },
    /// The search was stopped before it had a result.
    #[error(
        "the search was ended before it found a start from which the simulation does not diverge: give it more time, or start values in the vehicle file (start = ...)"
    )]
    EndedEarly,
    /// The fitted model's poles cannot be computed.
    #[error(
        "the poles of the fitted model cannot be computed: {0}; give narrower bounds in the vehicle file"
    )]
    Poles(#[from] DecompositionError),
    /// Levels were to be subtracted although an effect depends on them.
    #[error(
        "--detrend is only valid for models that are linear about a level, but '{vehicle}' has {effect}, which depends on the location of zero: use --offsets instead"
    )]
    Level {
        /// Name of the vehicle.
        vehicle: String,
        /// Name and place of the effect.
        effect: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}
