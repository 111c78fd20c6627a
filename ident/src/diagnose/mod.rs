//! Diagnosis: what a simulation gets wrong, why, and what is gained by mending it.

pub mod adequacy;
pub mod answer;
mod checks;
pub mod data;
mod describe;
pub mod engine;
mod error;
pub mod events;
mod evidence;
mod experiments;
pub mod gains;
pub mod heldout;
mod kalman;
pub mod library;
pub mod model;
pub mod noise;
mod run;
pub mod runner;
pub mod samples;
pub mod screen;
pub mod select;
pub mod stochastic;
pub mod survey;
mod text;
pub mod tones;
mod turbulent;
mod whittle;
mod words;

pub use answer::{DIAGNOSIS_SCHEMA, Diagnosis, Verdict};
pub use error::DiagnoseError;
pub use run::{Options, diagnose};
