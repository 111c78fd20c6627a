//! Control: Riccati equations, LQR, pole placement, sliding mode and Kalman filters.
//!
//! The crate works on matrices, not on vehicle files; of the vehicle crate it uses the discretisation and the
//! linear model. A [`SampledPlant`] is made from A, B, the period, limits and names. A [`Design`] is computed
//! from a plant and [`LawOptions`], and contains gains, poles and margins; a [`Controller`] runs it. An
//! [`Estimator`] estimates from measurements the state that the controller feeds back.

mod actuation;
mod compensation;
mod controller;
pub mod design;
mod handover;
mod hessenberg;
mod input_limits;
pub mod kalman;
mod kernel;
pub mod lqr;
pub mod margins;
pub mod options;
mod outcome;
pub mod place;
pub mod responses;
pub mod riccati;
mod rows;
mod sampled_model;
mod sampled_plant;
mod scales;
pub mod smc;
mod target;

pub use compensation::{Compensation, Declined};
pub use controller::Controller;
pub use controller::lanes::{ControllerLanes, OutcomeLanes};
pub use design::{Design, DesignError};
pub use input_limits::InputLimits;
pub use kalman::{
    Estimator, EstimatorError, EstimatorKind, EstimatorLanes, EstimatorOptions, FilterModel, KalmanFilter,
    Sensors, VibrationModel, settled_covariance,
};
pub use options::{AntiWindup, LawOptions, LqrOptions, PpcOptions, Selector, SmcOptions, Weights};
pub use outcome::Outcome;
pub use responses::Responses;
pub use sampled_model::{Layout, SampledModel};
pub use sampled_plant::{SampledPlant, SampledPlantError};
