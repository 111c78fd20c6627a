//! Measurements of `whirlstand bench`: throughput, latency and jitter, each compared with the bare minimum of
//! the same machine in the same run.
//!
//! Every process of a measurement is this same executable, started again with [`Options::member`] and a
//! [`Member`] as JSON on standard input; [`run_member`] then runs it.

mod autopilot;
mod bridge;
mod cyclictest;
mod echo;
mod error;
mod figure;
mod fleet;
mod measured_bench;
mod member;
mod options;
mod realtime;
mod round_trips;
mod throughput;
mod transports;
mod two_hosts;
mod witness;

use serde::Serialize;

pub use error::BenchError;
pub use figure::{Figure, Goal};
pub use member::{Member, run_member};
pub use options::{MEASUREMENTS, Options};

/// Report of all measured figures.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Schema identifier, `whirlstand.bench.v1`.
    pub schema: &'static str,
    /// Number of CPUs that this process may use.
    pub cpus: usize,
    /// Kernel version from `/proc/version`.
    pub kernel: String,
    /// The figures.
    pub figures: Vec<Figure>,
}

/// Runs the measurements; `progress` receives each figure when it is measured.
///
/// # Errors
/// [`BenchError`] for the first measurement that cannot run.
pub fn run(options: &Options, mut progress: impl FnMut(&Figure)) -> Result<Report, BenchError> {
    if let Some(unknown) = options.what.iter().find(|w| !MEASUREMENTS.contains(&w.as_str())) {
        return Err(BenchError::Unknown(unknown.clone()));
    }
    let mut figures = Vec::new();
    for name in MEASUREMENTS {
        if !options.what.is_empty() && !options.what.iter().any(|w| w == name) {
            continue;
        }
        let new = match name {
            "plant" => throughput::plant(options)?,
            "inproc" => throughput::inproc(options)?,
            "flight" => throughput::flight(options)?,
            "lockstep" => throughput::lockstep(options)?,
            "recorded" => throughput::recorded(options)?,
            "zenoh" => throughput::zenoh(options)?,
            "realtime" => realtime::realtime(options)?,
            "transports" => transports::transports(options)?,
            "vehicles" => bridge::bridges(options)?,
            _ => autopilot::autopilots(options)?,
        };
        new.iter().for_each(&mut progress);
        figures.extend(new);
    }
    Ok(Report {
        schema: "whirlstand.bench.v1",
        cpus: std::thread::available_parallelism().map_or(1, usize::from),
        kernel: std::fs::read_to_string("/proc/version").unwrap_or_default().trim().into(),
        figures,
    })
}
