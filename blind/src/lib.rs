//! Blind trials: records with hidden effects, and a score of how well the diagnosis identifies them.
//!
//! The generator shares only the vehicle's data with the simulator and with the diagnosis: it has its own
//! integrator, its own implementation of the effects, written from the table's definitions, and its own
//! noise.

mod autoregression;
mod baseline;
mod chain;
mod closed_loop;
mod commands;
mod detect;
mod diagnosis;
mod draft;
mod error;
mod excitation;
mod experiment;
mod facts;
mod generator;
mod hidden;
mod hide;
mod integrator;
mod law;
mod linear;
mod manoeuvres;
mod motion;
mod nearest;
mod noise;
mod out_of_library;
mod out_of_library_draft;
mod plan;
mod poles;
mod random;
mod ranges;
mod reference;
mod score;
mod sense;
mod shifted;
mod signal;
mod tally;
mod text;
mod trial;
mod truth_model;
mod turbulence;
mod vehicles;

#[cfg(test)]
mod tests;

pub use commands::Commands;
pub use diagnosis::{Cause, Diagnosis, Heldout, OutputFigures};
pub use error::BlindError;
pub use excitation::Excitation;
pub use experiment::Setting;
pub use generator::Generator;
pub use noise::Colour;
pub use out_of_library::OutOfLibrary;
pub use plan::{Case, Loops, Plan, TRIALS_PER_SEED};
pub use score::{CONFUSABLE, COUNTS_FROM, Outcome, Scored, ScoredParameter, truth_name};
pub use tally::{Class, Goal, Row, SCHEMA, Tally};
pub use text::opened;
pub use trial::{Answer, Trial, Truth};
pub use turbulence::Spectrum;
