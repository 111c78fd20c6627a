//! Errors for which no vehicle can be drafted from a log.

use whirlstand_logs::AnyReadError;
use whirlstand_vehicle::{EffectError, VehicleError};

use crate::identify::IdentifyError;

/// Reason why no vehicle can be drafted from a log. No file was written.
#[derive(Debug, thiserror::Error)]
pub enum DraftError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(Box<AnyReadError>),
    /// No signal is recognised as an input or as an output.
    #[error(
        "{log}: no signal was recognised as {what}: choose one with {flag} NAME, or {flag} NAME=SIGNAL[unit]; `whirlstand log info {log}` lists the signals. {hint}"
    )]
    NoSignal {
        /// Path of the log.
        log: String,
        /// Kind of signal that is missing, as "an input".
        what: &'static str,
        /// Command-line option that selects such a signal.
        flag: &'static str,
        /// Description of such a signal.
        hint: &'static str,
    },
    /// A chosen name is not in the log, or is not a valid name in a vehicle file.
    #[error("{flag} {text}: {reason}")]
    Choice {
        /// Command-line option.
        flag: &'static str,
        /// Text that was given.
        text: String,
        /// What is wrong with the text.
        reason: String,
    },
    /// No input changes.
    #[error(
        "{log}: the vehicle is at rest: no input changes ({inputs}). Without excitation nothing can be identified; select a part in which it flies (--from, --to), or fly doublets or an input designed by `whirlstand excite`"
    )]
    InputsAtRest {
        /// Path of the log.
        log: String,
        /// Names of the inputs.
        inputs: String,
    },
    /// No output changes beyond its noise.
    #[error(
        "{log}: the vehicle is at rest: {outputs} show sensor noise and almost no motion. Its dynamics cannot be identified without motion; select a part in which it flies (--from, --to)"
    )]
    OutputsAtRest {
        /// Path of the log.
        log: String,
        /// The outputs with their spread and their noise.
        outputs: String,
    },
    /// The motor commands are constant.
    #[error(
        "{log}: the motors are off: {motors} never change, so {inputs} do not reach the motors and the motion has another cause, such as handling. Select a part in which it flies (--from, --to)"
    )]
    MotorsOff {
        /// Path of the log.
        log: String,
        /// Names of the motor signals.
        motors: String,
        /// Names of the inputs.
        inputs: String,
    },
    /// Inputs or outputs are sampled too slowly.
    #[error(
        "{log}: logged too slowly for a model of the motors or of the rates: {signals}. Those of a small vehicle settle within about 0.2 s, which requires a sample at least every {longest_ms:.0} ms; fewer suffice only where the signals change little from one to the next and the inputs are seen to act. Raise the rate of these topics in the logger, or choose faster ones with --input and --measure{unit}"
    )]
    TooSlow {
        /// Path of the log.
        log: String,
        /// The slow signals with their intervals.
        signals: String,
        /// The longest sufficient interval, ms.
        longest_ms: f64,
        /// Remark on the unit of the record's times, where it may be another; with a blank before it.
        unit: String,
    },
    /// The inputs explain no output.
    #[error(
        "{log}: the record shows no effect of the actuators: on held-out data no input predicts an output significantly better than the output's own past does ({found}). Check that the motors ran and that the right inputs are chosen (--input NAME), or fly with more excitation, such as an input designed by `whirlstand excite`"
    )]
    Unexplained {
        /// Path of the log.
        log: String,
        /// Result for every output, as text.
        found: String,
    },
    /// The inputs act, but no structure predicts held-out data.
    #[error(
        "{log}: the inputs act on the outputs, but no axis of first or second order with a lag and a delay predicts held-out data better than the outputs' own past does ({found}). Choose the inputs nearest to the motors (--input NAME) and signals that were not smoothed afterwards (--measure NAME), take the part that flies most (--from, --to), or fly with more excitation, such as an input designed by `whirlstand excite`"
    )]
    NoStructure {
        /// Path of the log.
        log: String,
        /// Result for every output, as text.
        found: String,
    },
    /// The record is too short to hold data out.
    #[error(
        "{log}: {seconds:.1} s in {steps} steps are too short to fit a model and to check it on held-out data: at least {needed} steps are needed. Give a longer record"
    )]
    TooShort {
        /// Path of the log.
        log: String,
        /// Length of the record, s.
        seconds: f64,
        /// Number of steps of the record.
        steps: usize,
        /// Number of steps that suffice.
        needed: usize,
    },
    /// The record cannot be resampled evenly, or an input is missing.
    #[error(transparent)]
    Data(Box<IdentifyError>),
    /// A structure cannot be written as a vehicle.
    #[error(transparent)]
    Effect(Box<EffectError>),
    /// The text of the vehicle file does not read back.
    #[error(transparent)]
    Vehicle(Box<VehicleError>),
}

impl From<AnyReadError> for DraftError {
    fn from(error: AnyReadError) -> Self {
        Self::Read(Box::new(error))
    }
}

impl From<IdentifyError> for DraftError {
    fn from(error: IdentifyError) -> Self {
        Self::Data(Box::new(error))
    }
}

impl From<EffectError> for DraftError {
    fn from(error: EffectError) -> Self {
        Self::Effect(Box::new(error))
    }
}

impl From<VehicleError> for DraftError {
    fn from(error: VehicleError) -> Self {
        Self::Vehicle(Box::new(error))
    }
}
