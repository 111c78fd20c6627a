//! Blind trials: records with a hidden effect, and how well diagnosis names it.
//!
//! The generator shares nothing with the simulator and with diagnosis but the vehicle's data: it has its own
//! integrator, its own effects, written from the table's definitions, and its own noise.

mod chain;
mod detect;
mod diagnosis;
mod draft;
mod excitation;
mod facts;
mod hide;
mod integrator;
mod linear;
mod motion;
mod nearest;
mod noise;
mod outside;
mod plan;
mod plant;
mod random;
mod scene;
mod score;
mod sense;
mod signal;
mod strange;
mod tally;
mod text;
mod trial;
mod vehicles;

#[cfg(test)]
mod tests;

pub use diagnosis::{Cause, Diagnosis, Heldout, OutputFigures};
pub use excitation::Excitation;
pub use noise::Colour;
pub use outside::Strange;
pub use plan::{Case, Plan, TRIALS_PER_SEED};
pub use plant::Commands;
pub use scene::Setting;
pub use score::{CONFUSABLE, COUNTS_FROM, Outcome, Scored, ScoredParameter, words};
pub use tally::{Class, Goal, Row, SCHEMA, Tally};
pub use text::opened;
pub use trial::{Answer, Trial, Truth};

/// Why a trial cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum BlindError {
    /// An effect, or the vehicle that it names, does not fit.
    #[error("{0}")]
    Effect(String),
    /// Without noise there is no detectability.
    #[error(
        "the vehicle '{vehicle}' declares no noise for its output '{output}', but blind trials need to know how noisy every sensor is: add noise = ... to [[outputs]]"
    )]
    NoNoise {
        /// The vehicle.
        vehicle: String,
        /// Its output.
        output: String,
    },
    /// The motion left all bounds.
    #[error("the vehicle leaves all bounds at {at_s:.2} s under this excitation")]
    Diverged {
        /// When, s.
        at_s: f64,
    },
}

impl BlindError {
    pub(crate) fn effect(error: impl std::fmt::Display) -> Self {
        Self::Effect(error.to_string())
    }
}
