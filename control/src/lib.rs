//! What steers: Riccati, LQR, pole placement, sliding mode and Kalman filters.
//!
//! The room knows matrices, not vehicle files: a [`Plant`] is made from A, B, the period, limits and names. A
//! [`Design`] is computed from a plant and [`LawOptions`], and tells gains, poles and margins; a [`Controller`]
//! runs it. An [`Estimator`] turns measurements into the state that the controller feeds back.

mod controller;
pub mod design;
pub mod kalman;
mod kernel;
pub mod linalg;
pub mod lqr;
pub mod margins;
pub mod options;
pub mod place;
mod plant;
pub mod riccati;
mod rows;
pub mod smc;
mod target;

pub use controller::{Controller, Outcome};
pub use design::{Design, DesignError};
pub use kalman::{Estimator, EstimatorError, EstimatorKind, EstimatorOptions, KalmanFilter, Sensors};
pub use options::{AntiWindup, LawOptions, LqrOptions, PpcOptions, Selector, SmcOptions, Weights};
pub use plant::{InputLimits, Plant, PlantError};
