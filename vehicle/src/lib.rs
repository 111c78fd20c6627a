//! Vehicles and their simulation: state-space models, effects, sensors and vehicle files.
//!
//! A [`Vehicle`] is read from a vehicle file (`docs/vehicle-file.md`) or built in; a [`Simulator`] flies it.
//!
//! ```
//! use whirlstand_vehicle::{Simulator, Vehicle};
//!
//! let vehicle = Vehicle::builtin("quadrotor").unwrap();
//! let mut simulator = Simulator::new(&vehicle, 0.005, 1).unwrap();
//! for _ in 0..200 {
//!     simulator.step(&[1.0, 0.0]);
//! }
//! let roll = simulator.state()[vehicle.state_index("roll").unwrap()];
//! assert!(roll < 0.0);
//! let measured = simulator.measure();
//! assert!((measured[0] - roll).abs() < 0.01);
//! ```

mod builtin;
mod discretise;
mod doubling;
mod effects;
mod error;
mod extend;
mod file;
mod find;
mod free;
mod free_values;
mod kinematics;
mod model;
mod normals;
mod plausible;
mod random;
mod signal_unit;
mod simulator;
mod subsystem;

pub use builtin::{builtin_names, template_names};
pub use discretise::{DiscretiseError, discretise, finite_horizon_gramian, matrix_exponential};
pub use effects::{
    Effect, FieldValue, Kind, Matrix, Parameter, ParameterUnit, Place, PlaceKind, Requirement, SPECS, Scale,
    Spec, Window,
};
pub use error::{EffectError, FileError, SimulatorError, VehicleError};
pub use free::{ESTIMATED_IN_MOTION, FIT_PERIOD, Free, Provenance, SENSOR_NOISE, Target};
pub use kinematics::kinematic_row;
pub use model::{Engine, Input, Intersample, Output, State, Vehicle, Vibration};
pub use plausible::check_attitude;
pub use random::Stream;
pub use signal_unit::SignalUnit;
pub use simulator::{
    Backlash, Friction, HammersteinModel, InputEffects, InputPaths, LinearModel, RateLimit, Rows, Simulator,
    SimulatorLanes, dead_zone, split_time,
};
pub use subsystem::Subsystem;
