//! Options of `whirlstand bench mirror`.

use std::num::NonZeroUsize;

use clap::Args;

use super::JsonArg;
use super::quantity::hertz;

/// Measure the live mirror: flights with an effect that starts at a random time, and clean ones.
///
/// Flies in this process, in lockstep: the results do not depend on how busy the machine is. For each effect it
/// reports how often the right name was given 10 s after the onset (among the flights with sufficient information),
/// how often a wrong one or none, and the median alarm delay compared with the shortest that any test could reach
/// (Lorden's bound).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand bench mirror --trials 50 --clean 2 --seed 1\n  \
    whirlstand bench mirror --effects backlash,limit --clean 0 --show\n\n\
    Exit code 1 when a goal is missed. Ctrl-C ends it early, with the results so far; exit code 130.")]
pub(crate) struct BenchMirrorArgs {
    /// Flights with each effect.
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub trials: u64,
    /// Clean flight of the quadrotor, hours.
    #[arg(long, value_name = "HOURS", default_value_t = 0.5, value_parser = hours)]
    pub clean: f64,
    /// Seed; flight K has the number SEED x 1000000 + K.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Only these effects, separated by commas, for example lag,stuck-sensor [default: all twelve]
    #[arg(long, value_name = "EFFECT,...", value_delimiter = ',')]
    pub effects: Vec<String>,
    /// Rate of the loop, in Hz or with a unit.
    #[arg(long, value_name = "FREQUENCY", value_parser = hertz, default_value_t = BenchMirrorArgs::RATE_HZ)]
    pub rate: f64,
    /// Flights at the same time [default: one for each processor]
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Print the findings of every flight with a wrong name or none, and of clean flights with alarms.
    #[arg(long)]
    pub show: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

impl BenchMirrorArgs {
    /// Rate where nothing else is asked for, Hz.
    pub const RATE_HZ: f64 = 200.0;
}

/// Reads a number of hours.
fn hours(text: &str) -> Result<f64, String> {
    let known = text.trim().parse().ok().filter(|h: &f64| (0.0..=1000.0).contains(h));
    known.ok_or_else(|| format!("hours from 0 to 1000 are expected, not '{text}'"))
}
