//! What data says: compare, identify, diagnose and report.

pub mod metrics;
pub mod spectrum;
mod stats;
