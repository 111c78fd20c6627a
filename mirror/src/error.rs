//! Errors in the construction of a mirror.

use thiserror::Error;
use whirlstand_control::SampledPlantError;
use whirlstand_vehicle::{DiscretiseError, SimulatorError};

/// The reason why a vehicle cannot be mirrored.
#[derive(Debug, Error)]
pub enum MirrorError {
    /// The effects do not fit the vehicle, or it overflows in one period.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// An unstable mode is too fast for the period.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
    /// The vehicle has no sampled model.
    #[error(transparent)]
    Plant(#[from] SampledPlantError),
    /// The states are not detectable from the measurements.
    #[error(
        "no filter with finite memory can estimate the states of {vehicle} from its measurements: {reason}"
    )]
    Unobservable {
        /// The vehicle's name.
        vehicle: String,
        /// The error of the Riccati equation.
        reason: String,
    },
    /// The vehicle measures no output, or more than a filter accepts.
    #[error("{vehicle} has {count} outputs; 1 to 64 can be monitored")]
    Outputs {
        /// The vehicle's name.
        vehicle: String,
        /// Number of outputs.
        count: usize,
    },
}
