//! Why an identification cannot be made.

use whirlstand_linalg::DecompositionError;
use whirlstand_logs::shown::clean;
use whirlstand_vehicle::SimulatorError;

use crate::compare::CompareError;

/// Why an identification cannot be made. Nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// The vehicle file frees nothing.
    #[error(
        "'{vehicle}' has no free parameter: add free = [{{ entry = \"A[2,1]\", lower = -10.0, upper = 10.0 }}, ...] to its file, or start from a template (quadrotor-structure, helicopter-structure)"
    )]
    NothingFree {
        /// The vehicle.
        vehicle: String,
    },
    /// The record does not fit the vehicle.
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
        /// Its period.
        first_s: f64,
        /// Name of the log with another period.
        other: String,
        /// Its period.
        other_s: f64,
    },
    /// No input moves.
    #[error(
        "{origin}: no input of the vehicle changes between {} s and {} s ({inputs}): without excitation nothing can be identified; fly doublets or an input designed by `whirlstand excite`",
        clean(*from_s), clean(*until_s)
    )]
    NoExcitation {
        /// The log.
        origin: String,
        /// Start of the part, s.
        from_s: f64,
        /// End of the part, s.
        until_s: f64,
        /// The inputs.
        inputs: String,
    },
    /// Fewer samples than unknowns.
    #[error(
        "{samples} measured values cannot determine {unknowns} unknowns ({parameters} parameters, plus the initial state and offsets of each part): give a longer record or free fewer parameters"
    )]
    TooFew {
        /// Measured values.
        samples: usize,
        /// All unknowns.
        unknowns: usize,
        /// Parameters among them.
        parameters: usize,
    },
    /// The simulation diverges from every start.
    #[error(
        "the simulation diverges from every start ({tried} tried): give stable start values in the vehicle file (start = ...) or narrower bounds, or use --noise kalman, which needs no stable simulation"
    )]
    UnstableStart {
        /// How many starts were tried.
        tried: usize,
    },
    /// The search was ended before it had anything to answer with.
    #[error(
        "the search was ended before it found a start from which the simulation does not diverge: give it more time, or start values in the vehicle file (start = ...)"
    )]
    EndedEarly,
    /// The fitted model's poles cannot be computed.
    #[error(
        "the poles of the fitted model cannot be computed: {0}; give narrower bounds in the vehicle file"
    )]
    Poles(#[from] DecompositionError),
    /// Levels were to be taken off although an effect depends on them.
    #[error(
        "--detrend is only valid for models that are linear about a level, but '{vehicle}' has {effect}, which depends on the location of zero: use --offsets instead"
    )]
    Level {
        /// The vehicle.
        vehicle: String,
        /// The effect and its place.
        effect: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}
