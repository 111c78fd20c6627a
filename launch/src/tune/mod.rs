//! `whirlstand tune`: a record, its causes, a law for the vehicle as it is, and what that law is worth in flight.
//!
//! The old law and the new one fly the extended vehicle in this process, over draws of what the diagnosis is not sure of:
//! the same draw for both, so that what differs is the law. The new one is kept only where that is certain.

mod answer;
mod circle;
mod draws;
mod joint;
mod judge;
mod pilot;
mod retune;
mod text;
mod trials;
mod truth;
mod tuned;

pub(crate) use answer::Tuning;
pub(crate) use circle::{circle, tune};
pub(crate) use judge::{LawFigures, compare_costs, cost};
