//! Vehicle files, models and the simulator.

mod allocation;
mod blocks;
mod composition;
mod discretisation;
mod free;
mod support;
mod units;
mod vehicle_file;
mod windows;
