//! Options of `whirlstand bench tune`.

use std::path::PathBuf;

use clap::Args;

use super::{JsonArg, ModeArg};

/// Measure tune: vehicles with a hidden effect, tuned from a record of one flight and flown again on the true
/// vehicle.
///
/// Flies in this process, in lockstep, unless --processes is given: the results do not depend on how busy the machine
/// is. A cell is a vehicle, a law and an effect. For each it reports the cost, on the true vehicle, of the old law,
/// of the law in `tuned.toml`, and of one designed for the true vehicle.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand bench tune --out out/proof\n  \
    whirlstand bench tune --out out/proof --only lqr/input_delay --only quadrotor/smc\n  \
    whirlstand bench tune --out out/proof --table\n  \
    whirlstand bench tune --out out/realtime --processes realtime --only quadrotor/lqr/input_delay\n\n\
    Cells that are in OUT/cells.jsonl are not flown again, so it can be stopped and restarted at any time. \
    OUT/table.md has the table of all of them. Exit code 1 when a goal is missed; 130 when it was interrupted.")]
pub(crate) struct BenchTuneArgs {
    /// Folder for cells.jsonl and table.md.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Only cells whose vehicle/law/effect has all of these words; may be repeated [default: all]
    #[arg(long, value_name = "WORD/...")]
    pub only: Vec<String>,
    /// Number of draws flown with each law, and of seeds on the true vehicle.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u64).range(20..))]
    pub draws: u64,
    /// Fly the record and the true vehicle as processes on the bus, in realtime or in lockstep, and evaluate their
    /// logs; each flight of a cell takes 32 s in realtime.
    #[arg(long, value_enum, value_name = "MODE")]
    pub processes: Option<ModeArg>,
    /// Number of seeds flown with each law on the true vehicle with --processes.
    #[arg(long, value_name = "N", default_value_t = 3, requires = "processes", value_parser = clap::value_parser!(u64).range(2..))]
    pub seeds: u64,
    /// Fly nothing: only write the table of the existing cells.
    #[arg(long)]
    pub table: bool,
    #[command(flatten)]
    pub json: JsonArg,
}
