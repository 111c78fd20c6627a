//! Figures of merit of recorded runs, and whether they meet the expectations of a launch file.

pub mod expectation;
pub mod metrics;
pub mod run;
pub mod summary;

pub use expectation::{CheckedExpectation, Expectation};
pub use run::{Run, RunError};
pub use summary::{Figure, RunSummary};
