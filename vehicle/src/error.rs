//! Errors of vehicles, as full sentences.

use std::path::PathBuf;

use whirlstand_linalg::DecompositionError;
use whirlstand_msgs::units::clean;

/// Reason why a vehicle cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    Read {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The text is not a vehicle file.
    #[error(transparent)]
    File(#[from] FileError),
    /// The name is neither a built-in vehicle nor a file.
    #[error(
        "there is no vehicle '{name}'{nearest}: the built-in ones are {known}; a path to a vehicle file (.toml) can also be given"
    )]
    Unknown {
        /// Requested name.
        name: String,
        /// The nearest built-in name as a question, or empty.
        nearest: String,
        /// Names of the built-in vehicles.
        known: String,
    },
    /// An effect does not fit the vehicle.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

/// An error in a vehicle file, with its location.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {}{reason}", line.map(|l| format!(", line {l}")).unwrap_or_default(), field_prefix(field))]
pub struct FileError {
    /// Path of the file, or the origin of the text.
    pub file: String,
    /// Line number, from 1, where known.
    pub line: Option<usize>,
    /// The field, for example `outputs[2].noise`; empty for the file as a whole.
    pub field: String,
    /// What was expected, what was found and what to do.
    pub reason: String,
}

fn field_prefix(field: &str) -> String {
    if field.is_empty() { String::new() } else { format!("{field}: ") }
}

/// An error of an effect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EffectError {
    /// Name of the effect.
    pub effect: String,
    /// Place of the effect, as written.
    pub place: String,
    /// The wrong key, if it is a single one.
    pub field: Option<String>,
    /// What was expected, what was found and what to do.
    pub reason: String,
}

impl std::error::Error for EffectError {}

impl std::fmt::Display for EffectError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "effect {}", self.effect)?;
        if !self.place.is_empty() {
            write!(f, " at '{}'", self.place)?;
        }
        match self.field.as_deref() {
            // The reason already quotes the key.
            Some(field) if !self.reason.starts_with('\'') && !self.reason.starts_with("there is no") => {
                write!(f, ": {field} {}", self.reason)
            }
            _ => write!(f, ": {}", self.reason),
        }
    }
}

/// Reason why a simulation cannot be set up.
#[derive(Debug, thiserror::Error)]
pub enum SimulatorError {
    /// The sample period is not a positive, finite number.
    #[error("the sample period must be a positive number of seconds, but is {0}")]
    Period(f64),
    /// The matrix exponential over one period is not finite.
    #[error(
        "'{vehicle}' cannot be simulated with a period of {} s: its fastest mode overflows",
        clean(*period_s)
    )]
    NotFinite {
        /// Name of the vehicle.
        vehicle: String,
        /// Sampling period, s.
        period_s: f64,
    },
    /// The poles of the vehicle with its filters, which determine the step size, cannot be computed.
    #[error("the vehicle cannot be simulated, as its poles cannot be computed: {0}")]
    Poles(#[from] DecompositionError),
    /// Too many effects that change the matrices have a window.
    #[error(
        "{found} delays, lags, modes, couplings, parameter changes and mode transitions have from_s or until_s, but \
         at most {most} are supported, as a step is precomputed for every combination; remove the window from some \
         of them"
    )]
    Windows {
        /// Number of such effects.
        found: usize,
        /// Largest number of such effects.
        most: usize,
    },
    /// An effect does not fit the vehicle.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

/// Joins names as `a, b, c`.
pub(crate) fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.collect::<Vec<_>>().join(", ")
}
