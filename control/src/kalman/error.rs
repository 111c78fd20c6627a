//! Errors of an estimator's design.

use thiserror::Error;
use whirlstand_vehicle::DiscretiseError;

/// Reason why an estimator cannot be designed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EstimatorError {
    /// The sensors do not match the plant.
    #[error("the sensors do not fit the plant: {0}")]
    Sensors(String),
    /// An option names an unknown signal, or has an invalid value.
    #[error("`{option}`: {why}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// The outputs do not determine a state or bias.
    #[error("{what} cannot be told from the outputs {outputs}; measure more, or estimate fewer biases")]
    Unobservable {
        /// Description of the unobservable states.
        what: String,
        /// Names of the used outputs.
        outputs: String,
    },
    /// An unstable mode is too fast for the period.
    #[error("the filter cannot be sampled: {0}; an unstable mode of the plant is too fast for this period")]
    Discretise(#[from] DiscretiseError),
}
