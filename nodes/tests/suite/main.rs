//! Nodes as threads of one process.

mod adjustments;
mod closed_loop;
#[path = "../common/mod.rs"]
mod common;
mod lanes;
mod mirror;
mod onset;
mod plant_rules;
mod recorder_files;
