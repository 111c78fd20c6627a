//! The answer of a diagnosis: findings as figures, sentences and plots.

pub mod causes;
pub mod compose;
mod correlations;
pub mod curves;
pub mod doubts;
pub mod evidence;
pub mod evidence_plots;
pub mod evidence_random;
pub mod experiments;
pub mod gains;
pub(crate) mod reestimate;
pub mod remainder;
pub mod schema;
pub(crate) mod score;
pub mod terminal;
pub(crate) mod unforeseen;
pub mod vibration_source;

pub use schema::*;
