//! Identification of the free parameters of a vehicle from records.
//!
//! - [`data`]: stretches of records on an even grid; [`problem`]: the unknowns, and simulations with sensitivities.
//! - [`output_error`] and [`filter_error`]: the costs; [`search`]: Levenberg-Marquardt for either; [`start`]: start
//!   values from the data; [`pem`]: the complete fit. [`spread`]: accuracy of the parameters.

pub mod align;
pub mod answer;
pub mod ar;
pub mod batch;
pub mod data;
mod disturbed;
mod error;
pub mod filter_error;
pub mod fitted;
pub mod force_fit;
pub mod forces;
pub mod ga;
mod kalman;
mod linear;
pub mod normal;
pub mod options;
pub mod output_error;
pub mod pem;
pub mod predictor;
mod prepare;
pub mod problem;
pub mod quality;
pub mod response;
mod run;
pub mod search;
mod sensitivity;
mod simulated;
pub mod spread;
pub mod start;
mod step;
mod sums;
pub mod sweep;
#[cfg(test)]
mod tests;
mod text;

pub use answer::{IDENTIFICATION_SCHEMA, Identification, Log};
pub use data::Segment;
pub use error::IdentifyError;
pub use options::{Method, Options};
pub use pem::Noise;
pub use problem::Nuisance;
pub use run::{AT_BOUND, Source, identify};
