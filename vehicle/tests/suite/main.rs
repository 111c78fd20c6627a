//! Vehicle files, models and the simulator.

mod allocation;
mod blocks;
mod composition;
mod discretisation;
mod free;
mod short_lags;
mod support;
mod units;
mod vehicle_file;
mod windows;
