//! Kalman filters that estimate the full state.
//!
//! The filter uses one of two models:
//! - [`EstimatorKind::Kinematic`] contains only the integration of rates to angles and of speeds to
//!   positions; everything else is a random walk that measurements correct. As in the paper, rates are
//!   estimated from angles. It uses no force model, and no input.
//! - [`EstimatorKind::Model`] predicts with the discretised vehicle and the inputs that act on it.
//!
//! By default a bias is estimated for gyros only, where it is observable by kinematics alone: the angle is
//! measured too, and its derivative is the rate. The bias of an angle can be distinguished from a constant
//! disturbance only by an exact force model, so it is estimated only on request; a set of biases that is not
//! observable from the outputs is rejected. The same holds for the offsets of inputs.

mod acting;
mod covariance;
mod error;
mod extended;
mod filter;
mod filter_model;
mod flow;
mod lanes;
mod measurement_age;
mod model;
mod observability;
mod offsets;
mod options;
mod recursion;
mod schedule;
mod sensors;
mod settled;
#[cfg(test)]
mod tests;

pub use error::EstimatorError;
pub use filter::KalmanFilter;
pub use filter_model::FilterModel;
pub use lanes::EstimatorLanes;
pub use measurement_age::{AgeSpread, MeasurementAge};
pub use model::Estimator;
pub use options::{EstimatorKind, EstimatorOptions, VibrationModel};
pub use sensors::Sensors;
pub use settled::settled_covariance;
