//! Why an estimator cannot be made.

use thiserror::Error;
use whirlstand_vehicle::DiscretiseError;

/// Why an estimator cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EstimatorError {
    /// Sensors that do not fit the plant.
    #[error("the sensors do not fit the plant: {0}")]
    Sensors(String),
    /// An option that names nothing, or has a wrong value.
    #[error("`{option}`: {why}")]
    Option {
        /// The option.
        option: &'static str,
        /// What is wrong.
        why: String,
    },
    /// A state or bias that the outputs do not show.
    #[error("{what} cannot be told from the outputs {outputs}; measure more, or estimate fewer biases")]
    Unobservable {
        /// What.
        what: String,
        /// The outputs used.
        outputs: String,
    },
    /// An unstable mode is too fast for the period.
    #[error("the filter cannot be sampled: {0}; an unstable mode of the plant is too fast for this period")]
    Discretise(#[from] DiscretiseError),
}
