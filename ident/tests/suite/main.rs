//! Identification from simulated records.

mod hidden_truth;
mod records;
mod support;
mod windows;
