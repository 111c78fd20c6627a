//! Why no vehicle can be drafted from a log.

use whirlstand_logs::AnyReadError;
use whirlstand_vehicle::{EffectError, VehicleError};

use crate::identify::IdentifyError;

/// Why no vehicle can be drafted from a log. Nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum DraftError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(Box<AnyReadError>),
    /// No signal is known as an input or as an output.
    #[error(
        "{log}: no signal was recognised as {what}: choose one with {flag} NAME, or {flag} NAME=SIGNAL[unit]; `whirlstand log info {log}` lists the signals. {hint}"
    )]
    NoSignal {
        /// The log.
        log: String,
        /// What is missing, as "an input".
        what: &'static str,
        /// The option that chooses it.
        flag: &'static str,
        /// What such a signal is.
        hint: &'static str,
    },
    /// A name that was chosen is not in the log, or cannot be a name in a vehicle file.
    #[error("{flag} {text}: {reason}")]
    Choice {
        /// The option.
        flag: &'static str,
        /// What was given.
        text: String,
        /// What is wrong with it.
        reason: String,
    },
    /// No input moves.
    #[error(
        "{log}: the vehicle is at rest: no input changes ({inputs}). Without excitation nothing can be identified; select a part in which it flies (--from, --to), or fly doublets or an input designed by `whirlstand excite`"
    )]
    InputsAtRest {
        /// The log.
        log: String,
        /// The inputs.
        inputs: String,
    },
    /// No output moves beyond its noise.
    #[error(
        "{log}: the vehicle is at rest: {outputs} show sensor noise and almost no motion. Its dynamics cannot be identified without motion; select a part in which it flies (--from, --to)"
    )]
    OutputsAtRest {
        /// The log.
        log: String,
        /// The outputs with their spread and their noise.
        outputs: String,
    },
    /// The motors' commands stand still.
    #[error(
        "{log}: the motors are off: {motors} never change, so {inputs} do not reach the motors and the motion has another cause, such as handling. Select a part in which it flies (--from, --to)"
    )]
    MotorsOff {
        /// The log.
        log: String,
        /// The signals of the motors.
        motors: String,
        /// The inputs.
        inputs: String,
    },
    /// Inputs or outputs come too seldom.
    #[error(
        "{log}: logged too slowly for a model of the motors or of the rates: {signals}. These dynamics settle within about 0.2 s, so a sample at least every {longest_ms:.0} ms is required; the inputs between samples are unknown. Raise the rate of these topics in the logger, or choose faster ones with --input and --measure"
    )]
    TooSlow {
        /// The log.
        log: String,
        /// The slow signals with their intervals.
        signals: String,
        /// The longest interval that would do, ms.
        longest_ms: f64,
    },
    /// The inputs explain nothing.
    #[error(
        "{log}: the record shows no effect of the actuators: on held-out data the inputs do not predict the outputs better than the outputs' own past ({found}). Check that the motors ran and that the right inputs are chosen (--input NAME), or fly with more excitation, such as an input designed by `whirlstand excite`"
    )]
    Unexplained {
        /// The log.
        log: String,
        /// What was found for every output.
        found: String,
    },
    /// Too little is left to hold data out.
    #[error(
        "{log}: {seconds:.1} s in {steps} steps are too short to fit a model and to check it on held-out data: at least {needed} steps are needed. Give a longer record"
    )]
    TooShort {
        /// The log.
        log: String,
        /// Length, s.
        seconds: f64,
        /// Steps of the record.
        steps: usize,
        /// Steps that would do.
        needed: usize,
    },
    /// The record has no even grid, or an input is missing.
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
