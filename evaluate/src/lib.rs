//! Figures of merit of recorded runs, and whether they meet the expectations of a launch file.

pub mod expectation;
pub mod flight;
pub mod flown;
pub mod health;
mod kept;
mod layout;
pub mod lines;
mod measures;
mod merge;
pub mod metrics;
mod output;
pub mod run;
pub mod spectra;
pub mod summary;
mod survey;

pub use expectation::{CheckedExpectation, Expectation};
pub use flight::Flight;
pub use flown::{Flown, FlownStep, FlownTogether, NodeCounts};
pub use health::NodeHealth;
pub use run::{Run, RunError};
pub use summary::{Figure, RunSummary};
