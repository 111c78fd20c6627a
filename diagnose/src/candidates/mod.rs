//! Candidate causes: every effect of the table at every place, and the events and tones that the residual
//! suggests.

pub mod candidate;
pub mod events;
mod excited_lines;
pub mod library;
pub mod tones;
pub mod transitions;

pub use candidate::{Candidate, Sizes, Tunable};
