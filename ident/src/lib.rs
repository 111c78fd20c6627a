//! Identification of a vehicle from records: simulation and prediction, parameter search, test inputs, comparison.

pub mod compare;
pub mod draft;
pub mod excite;
pub mod identify;
pub mod watch;

pub use compare::{CompareError, CompareOptions, Comparison, compare};
