//! Measuring bodies of `whirlstand bench`: throughput, latency and jitter, each beside the bare floor of the same
//! machine in the same run.
//!
//! Every process of a measurement is this same executable, started again with [`Options::member`] and a
//! [`Member`] as JSON on standard input; [`run_member`] is what it then does.

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

/// All figures of a call.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// `whirlstand.bench.v1`.
    pub schema: &'static str,
    /// CPUs that this process may use.
    pub cpus: usize,
    /// Kernel, as `/proc/version` says.
    pub kernel: String,
    /// The figures.
    pub figures: Vec<Figure>,
}

/// Runs the measurements; `progress` hears each figure as it comes.
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
