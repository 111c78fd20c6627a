//! What can be wrong with a vehicle, told in full sentences.

use std::path::PathBuf;

use whirlstand_linalg::DecompositionError;
use whirlstand_msgs::units::clean;

/// Why a vehicle cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not a vehicle file.
    #[error(transparent)]
    File(#[from] FileError),
    /// Neither a built-in vehicle nor a file.
    #[error(
        "there is no vehicle '{name}'{nearest}: the built-in ones are {known}; a path to a vehicle file (.toml) can also be given"
    )]
    Unknown {
        /// What was asked for.
        name: String,
        /// The nearest built-in name, as a question, or nothing.
        nearest: String,
        /// The built-in names.
        known: String,
    },
    /// An effect does not fit the vehicle.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

/// What is wrong in a vehicle file, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {}{reason}", line.map(|l| format!(", line {l}")).unwrap_or_default(), field_prefix(field))]
pub struct FileError {
    /// The file, or what the text came from.
    pub file: String,
    /// Line, from 1, where it is known.
    pub line: Option<usize>,
    /// The field, for example `outputs[2].noise`; empty for the file as a whole.
    pub field: String,
    /// What was expected, what was found and what to do.
    pub reason: String,
}

fn field_prefix(field: &str) -> String {
    if field.is_empty() { String::new() } else { format!("{field}: ") }
}

/// What is wrong with an effect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EffectError {
    /// Name of the effect.
    pub effect: String,
    /// Its place, as written.
    pub place: String,
    /// The key that is wrong, if it is one.
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
            // The reason quotes the key itself.
            Some(field) if !self.reason.starts_with('\'') && !self.reason.starts_with("there is no") => {
                write!(f, ": {field} {}", self.reason)
            }
            _ => write!(f, ": {}", self.reason),
        }
    }
}

/// Why a simulation cannot be set up.
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
        /// The vehicle.
        vehicle: String,
        /// The period.
        period_s: f64,
    },
    /// The poles of the vehicle with its filters, which say how fine a step has to be, cannot be computed.
    #[error("the vehicle cannot be simulated, as its poles cannot be computed: {0}")]
    Poles(#[from] DecompositionError),
    /// Too many effects that take other matrices have a window.
    #[error(
        "{found} delays, lags, modes, couplings, parameter changes and mode transitions have from_s or until_s, but \
         at most {most} are supported, as a step is precomputed for every combination; remove the window from some \
         of them"
    )]
    Windows {
        /// How many have one.
        found: usize,
        /// How many can.
        most: usize,
    },
    /// An effect does not fit the vehicle.
    #[error(transparent)]
    Effect(#[from] EffectError),
}

/// `a, b, c`.
pub(crate) fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.collect::<Vec<_>>().join(", ")
}
