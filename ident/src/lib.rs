//! What data says: compare, identify, diagnose and report.

pub mod blind;
pub mod compare;
pub mod excite;
pub mod identify;
pub mod metrics;
pub mod report;
pub mod run;
pub mod spectrum;
mod stats;
pub mod summary;
pub mod units;

pub use compare::{CompareError, CompareOptions, Comparison, compare};
pub use run::{Run, RunError};
pub use summary::{Figure, RunSummary};
