//! Options of the calls that look at this machine, and at how fast a bench runs on it: bench, doctor.

use clap::{Args, Subcommand};

use super::JsonArg;
use super::bench_tune::BenchTuneArgs;
use super::mirror::BenchMirrorArgs;
use super::quantity::seconds;

/// Measure latency, jitter and throughput, compared with the limits of this machine.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand bench lockstep recorded\n  \
    whirlstand bench realtime --realtime-seconds 60 --priority 80\n\n\
    Processes that are compared run on the same CPUs. The realtime measurement also runs cyclictest (Debian: \
    rt-tests) at the same priority.")]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct BenchArgs {
    #[command(subcommand)]
    pub command: Option<BenchCommand>,
    /// What to measure: plant, inproc, flight, lockstep, recorded, zenoh, realtime, transports,
    /// vehicles, autopilots [default: all]
    pub what: Vec<String>,
    /// Measure only the bridges: wire to bus and back, compared with a plain echo.
    #[arg(long)]
    pub bridge: bool,
    /// Length of each throughput measurement, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 2.0)]
    pub seconds: f64,
    /// Number of repetitions of each throughput measurement.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub repeat: u32,
    /// Length of each of the two flights of the realtime measurement, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 10.0)]
    pub realtime_seconds: f64,
    /// SCHED_FIFO priority of the realtime measurement [default: none]
    #[arg(long, value_name = "P", value_parser = priority, allow_negative_numbers = true)]
    pub priority: Option<u8>,
    /// CPUs of plant, estimator and controller in the lockstep measurement and in a realtime one with a priority, and of
    /// the reference ring [default: the scheduler decides; with a priority the last CPU]
    #[arg(long, value_name = "CPU,CPU,CPU", value_delimiter = ',')]
    pub cpus: Vec<usize>,
    #[command(flatten)]
    pub json: JsonArg,
    /// One process of a measurement, told on standard input what to do.
    #[arg(long, hide = true)]
    pub member: bool,
}

/// Measurements of something other than this machine.
#[derive(Debug, Subcommand)]
pub(crate) enum BenchCommand {
    Mirror(BenchMirrorArgs),
    Tune(BenchTuneArgs),
}

/// Check whether this machine is fit for real time, and say what to change.
#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    #[command(flatten)]
    pub json: JsonArg,
}

/// Reads a priority of SCHED_FIFO.
fn priority(text: &str) -> Result<u8, String> {
    let known = text.trim().parse().ok().filter(|p| (1..=99).contains(p));
    known.ok_or_else(|| format!("a priority of SCHED_FIFO, from 1 to 99, is expected, not '{text}'"))
}
