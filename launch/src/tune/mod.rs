//! `whirlstand tune`: from a record to its causes, a law for the actual vehicle, and the benefit of that law in
//! flight.
//!
//! The old and the new law fly the extended vehicle in this process, over draws from the uncertainty of the
//! diagnosis. Both laws fly the same draws, so that only the law differs. The new law is kept only where its
//! benefit is certain.

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
