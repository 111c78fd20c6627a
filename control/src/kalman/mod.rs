//! Kalman filters for the full state.
//!
//! Two models, one filter:
//! - [`EstimatorKind::Kinematic`] knows only that an angle is the integral of its rate and a position that of
//!   its speed; everything else is a random walk that the measurements hold. As in the paper, rates come from
//!   angles. It trusts no force model, and no input.
//! - [`EstimatorKind::Model`] predicts with the discretised vehicle and the inputs that act on it.
//!
//! A bias of an output is estimated only where kinematics alone make it observable: that of a rate or speed
//! whose integral (angle, position) is measured as well. The bias of an angle can be told from a constant
//! disturbance only by trusting the force model to its last digit, so it is estimated only when asked for, and
//! refused when even that does not make it observable.

mod filter;
mod model;

pub use filter::KalmanFilter;
pub use model::{Estimator, EstimatorError, EstimatorKind, EstimatorOptions, Sensors};
