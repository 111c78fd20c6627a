//! What could be wrong: every effect of the table at every place, events and tones that the residual suggests.

pub mod candidate;
pub mod events;
pub mod library;
pub mod tones;
pub mod transitions;

pub use candidate::{Candidate, Sizes, Tunable};
