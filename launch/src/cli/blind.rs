//! Options of `whirlstand blind`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};
use whirlstand_campaign::Shard;

use super::JsonArg;
use super::quantity::{hertz, moment};

/// Hide effects in simulated records, diagnose the records, and count what is found.
///
/// A generator that shares nothing with the diagnosis draws a record and seals the answer; `whirlstand diagnose` sees
/// the record and the nominal vehicle only. With your own vehicle and excitation, this shows before a flight what
/// that flight could reveal.
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  \
    whirlstand blind --trials 100 --seed 1\n  \
    whirlstand blind --trials 50 --vehicle mine.toml --input out/excite/inputs.csv --kinds single --out out/blind\n  \
    whirlstand blind --only 1000017 --keep out/trial\n  \
    whirlstand blind --trials 5000 --shard 3/8 --json part-3.json\n  \
    whirlstand blind merge part-*.json --json blind.json\n\n\
    Exit code 1 when a goal is missed. Ctrl-C ends a run early, with the results so far; exit code 130."
)]
pub(crate) struct BlindArgs {
    #[command(subcommand)]
    pub action: Option<BlindCommand>,
    #[command(flatten)]
    pub run: BlindRunArgs,
}

/// What else can be done with trials.
#[derive(Debug, Subcommand)]
pub(crate) enum BlindCommand {
    Merge(BlindMergeArgs),
}

/// Join the parts of a run; the result is that of an undivided run, except for the duration of each diagnosis.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand blind merge part-*.json --json blind.json")]
pub(crate) struct BlindMergeArgs {
    /// All parts, as --json wrote them, in any order.
    #[arg(required = true, value_name = "PART")]
    pub parts: Vec<PathBuf>,
    #[command(flatten)]
    pub json: JsonArg,
    /// Folder for blind.json and blind.txt.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// Options of the trials.
#[derive(Debug, Args)]
pub(crate) struct BlindRunArgs {
    /// Number of trials.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub trials: usize,
    /// Seed; trial K has the number SEED x 1000000 + K.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Built-in vehicle or path, the same in all trials [default: drawn]
    #[arg(long, value_name = "VEHICLE")]
    pub vehicle: Option<String>,
    /// Record with the inputs of that vehicle, flown in all trials [default: drawn]
    #[arg(long, value_name = "FILE")]
    pub input: Option<PathBuf>,
    /// Take an input from another column, for example u_roll=in_lat; may be repeated.
    #[arg(long = "map", value_name = "SIGNAL=NAME[UNIT]")]
    pub map: Vec<String>,
    /// Distributions that the trials are drawn from.
    #[arg(long, value_enum, value_name = "NAME", default_value_t = BlindGenerator::Reference)]
    pub generator: BlindGenerator,
    /// Whether a law flies the vehicle; --input is flown as it is.
    #[arg(long = "loop", value_enum, value_name = "LOOP", default_value_t = BlindLoop::Open, conflicts_with = "input")]
    pub control_loop: BlindLoop,
    /// Shortest and longest drawn record, or the length of all, in seconds or with units [default: the generator's, 30:120 and
    /// 20:100]
    #[arg(long, value_name = "FROM:TO", value_parser = lengths, conflicts_with = "input")]
    pub length: Option<(f64, f64)>,
    /// Sampling rates to draw from, in Hz or with a unit, separated by commas [default: the generator's, 50,100,200
    /// and 40,80,125,250]
    #[arg(long, value_name = "FREQUENCY,...", value_parser = rate, value_delimiter = ',', conflicts_with = "input")]
    pub rate: Option<Vec<f64>>,
    /// Only these effects of the table, separated by commas.
    #[arg(long, value_name = "EFFECT,...", value_delimiter = ',')]
    pub effects: Vec<String>,
    /// Only these kinds of trial, separated by commas.
    #[arg(long, value_enum, value_name = "KIND,...", value_delimiter = ',')]
    pub kinds: Vec<BlindCase>,
    /// Only the trial of this number.
    #[arg(long, value_name = "NUMBER", conflicts_with_all = ["trials", "seed", "effects", "kinds"])]
    pub only: Option<u64>,
    /// Only part K of N of the trials; `blind merge` joins their --json files. Goals are judged after merging.
    #[arg(long, value_name = "K/N", requires = "json", conflicts_with = "only")]
    pub shard: Option<Shard>,
    /// Resume an interrupted run of the same call: trials in its results (its --json) are not flown again.
    #[arg(long, value_name = "FILE", conflicts_with = "only")]
    pub resume: Option<PathBuf>,
    /// Trials at a time [default: one for each CPU]
    #[arg(long, value_name = "J")]
    pub jobs: Option<NonZeroUsize>,
    #[command(flatten)]
    pub json: JsonArg,
    /// Folder for blind.json, blind.txt, the list of seals, and the records of trials that were not answered
    /// correctly.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Folder for the records, answers and diagnoses of all trials.
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
    /// Another program to evaluate, called as `PROGRAM diagnose trial.csv --vehicle nominal.toml --json
    /// diagnosis.json`.
    #[arg(long, value_name = "PROGRAM")]
    pub program: Option<PathBuf>,
}

/// What trials are drawn from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum BlindGenerator {
    /// The ranges against which the diagnosis was developed.
    Reference,
    /// Other noise, vehicles, excitation and sizes, and other effects outside the table.
    Shifted,
}

/// Whether a law flies the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum BlindLoop {
    /// The commands are drawn.
    Open,
    /// A law computes the commands from noisy measurements.
    Closed,
    /// Every other trial is flown by a law.
    Both,
}

/// Kinds of trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum BlindCase {
    /// One effect of the table.
    Single,
    /// No effect.
    Clean,
    /// Two effects of the table.
    Pair,
    /// One effect that is not in the table.
    Outside,
}

impl BlindCase {
    /// The word on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Clean => "clean",
            Self::Pair => "pair",
            Self::Outside => "outside",
        }
    }
}

/// Reads `FROM:TO`, lengths of records, or one length.
fn lengths(text: &str) -> Result<(f64, f64), String> {
    let (from, to) = text.split_once(':').unwrap_or((text, text));
    match (moment(from), moment(to)) {
        (Ok(from), Ok(to)) if 5.0 <= from && from <= to && to <= 3600.0 => Ok((from, to)),
        _ => Err(format!(
            "'{text}' is not a range of lengths: write FROM:TO, as in 30:120 or \"30 s:2 min\", or one length, from 5 s to \
             3600 s"
        )),
    }
}

/// Reads a sampling rate.
fn rate(text: &str) -> Result<f64, String> {
    match hertz(text) {
        Ok(hz) if (5.0..=1000.0).contains(&hz) => Ok(hz),
        _ => Err(format!(
            "'{text}' is not a sampling rate: write Hz, from 5 to 1000, as in 200 or \"0.2 kHz\""
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::lengths;

    #[test]
    fn records_have_a_range_of_lengths_or_one() {
        assert_eq!(lengths("30 s:2 min"), Ok((30.0, 120.0)));
        assert_eq!((lengths("60"), lengths("60:60")), (Ok((60.0, 60.0)), Ok((60.0, 60.0))));
        for wrong in ["60:20", "4", "5:3601", "long", ":"] {
            assert!(lengths(wrong).is_err(), "{wrong}");
        }
    }
}
