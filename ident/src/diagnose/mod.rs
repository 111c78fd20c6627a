//! Diagnosis: what a simulation gets wrong, why, and what is gained by mending it.

pub mod adequacy;
pub mod answer;
mod checks;
mod curves;
pub mod data;
mod declared;
mod describe;
pub mod engine;
mod error;
pub mod events;
mod evidence;
mod evidence_random;
mod experiments;
pub mod gains;
pub mod heldout;
mod kalman;
pub mod library;
mod missing;
pub mod model;
pub mod noise;
mod run;
pub mod runner;
pub mod samples;
pub mod screen;
pub mod select;
mod shows;
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
