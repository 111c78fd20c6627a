//! Options of `whirlstand bench tune`.

use std::path::PathBuf;

use clap::Args;

use super::{JsonArg, ModeArg};

/// Measure tune: vehicles with a hidden effect, tuned from a record of one flight and flown again on the truth.
///
/// Flies in this process, in lockstep, where --processes asks for nothing else: what is measured does not depend on how busy the
/// machine is. A cell is a vehicle, a law
/// and an effect. Of each it tells what the old law costs on the truth, what the law of `tuned.toml`, and what one that was
/// designed on the truth itself.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand bench tune --out out/proof\n  \
    whirlstand bench tune --out out/proof --only lqr/input_delay --only quadrotor/smc\n  \
    whirlstand bench tune --out out/proof --table\n  \
    whirlstand bench tune --out out/realtime --processes realtime --only quadrotor/lqr/input_delay\n\n\
    Cells that are in OUT/cells.jsonl are not flown again, so it may be ended and started at any time. OUT/table.md has the table \
    of all of them. Exit code 1 when a goal is missed; 130 when it was interrupted.")]
pub(crate) struct BenchTuneArgs {
    /// Folder for cells.jsonl and table.md.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Only cells whose vehicle/law/effect has all of these words; may be repeated [default: all]
    #[arg(long, value_name = "WORD/...")]
    pub only: Vec<String>,
    /// Number of draws that both laws fly, and of seeds on the truth.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u64).range(20..))]
    pub draws: u64,
    /// Fly record and truth as processes on the bus, in realtime or in lockstep, and judge what their logs say; a cell takes 32 s a
    /// flight in realtime.
    #[arg(long, value_enum, value_name = "MODE")]
    pub processes: Option<ModeArg>,
    /// Number of seeds that each law flies on the truth over processes.
    #[arg(long, value_name = "N", default_value_t = 3, requires = "processes", value_parser = clap::value_parser!(u64).range(2..))]
    pub seeds: u64,
    /// Fly nothing: only the table of the cells that are there.
    #[arg(long)]
    pub table: bool,
    #[command(flatten)]
    pub json: JsonArg,
}
