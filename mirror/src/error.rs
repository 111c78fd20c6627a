//! What can stand in the way of a mirror.

use thiserror::Error;
use whirlstand_control::SampledPlantError;
use whirlstand_vehicle::{DiscretiseError, SimulatorError};

/// Why a vehicle cannot be mirrored.
#[derive(Debug, Error)]
pub enum MirrorError {
    /// Its effects do not fit it, or it overflows in one period.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
    /// An unstable mode is too fast for the period.
    #[error(transparent)]
    Discretise(#[from] DiscretiseError),
    /// It has no sampled model.
    #[error(transparent)]
    Plant(#[from] SampledPlantError),
    /// Its measurements do not show its states.
    #[error(
        "no filter with finite memory can estimate the states of {vehicle} from its measurements: {reason}"
    )]
    Unobservable {
        /// The vehicle's name.
        vehicle: String,
        /// What the Riccati equation says.
        reason: String,
    },
    /// It measures nothing, or more than a filter takes.
    #[error("{vehicle} has {count} outputs; 1 to 64 can be monitored")]
    Outputs {
        /// The vehicle's name.
        vehicle: String,
        /// How many.
        count: usize,
    },
}
