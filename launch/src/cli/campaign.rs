//! Options of `whirlstand campaign`.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use whirlstand_campaign::Shard;

use super::JsonArg;

/// Fly a launch file many times with varying parameters, and report how often limits are broken, and by what.
///
/// A campaign file names the launch file, what varies in it and how many flights there are (see docs/campaign.md).
/// Every flight runs in lockstep and in one thread; its draws depend on its number alone.
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    after_help = "Examples:\n  \
    whirlstand campaign gusts.toml --out out/gusts\n  \
    whirlstand campaign gusts.toml --out out/gusts --until-width 0.02\n  \
    whirlstand campaign gusts.toml --out out/gusts --shard 3/8 --resume\n  \
    whirlstand campaign merge out/gusts/part-*.parquet --out out/gusts\n  \
    whirlstand campaign replay gusts.toml --flight 417\n\n\
    Ctrl-C lets the current flights finish and keeps the results for --resume; exit code 130. Broken limits are \
    counted and are not a failure: exit code 0."
)]
pub(crate) struct CampaignArgs {
    #[command(subcommand)]
    pub action: Option<CampaignCommand>,
    #[command(flatten)]
    pub fly: CampaignFlyArgs,
}

/// What else can be done with a campaign.
#[derive(Debug, Subcommand)]
pub(crate) enum CampaignCommand {
    Replay(CampaignReplayArgs),
    Merge(CampaignMergeArgs),
}

/// Options of the flights.
#[derive(Debug, Args)]
pub(crate) struct CampaignFlyArgs {
    /// The campaign file.
    #[arg(required = true, value_name = "FILE")]
    pub file: Option<PathBuf>,
    /// Folder for flights.parquet and report.html [default: a new out/NAME-DATE-TIME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Flights at a time [default: one for each processor]
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Fly only part K of N, into part-K-of-N.parquet; `campaign merge` joins the parts.
    #[arg(long, value_name = "K/N", requires = "out")]
    pub shard: Option<Shard>,
    /// Resume an interrupted or killed campaign with the same file, folder and part; start from the beginning if
    /// there is none.
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Stop as soon as the 95 % interval of the share of flights that break a limit is this narrow, for example 0.02
    #[arg(long, value_name = "WIDTH", value_parser = width, conflicts_with = "shard")]
    pub until_width: Option<f64>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Repeat one flight of a campaign as separate processes and with a full log.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand campaign replay gusts.toml --flight 417 --out out/worst")]
pub(crate) struct CampaignReplayArgs {
    /// The campaign file.
    pub file: PathBuf,
    /// Number of the flight, from 0.
    #[arg(long, value_name = "N")]
    pub flight: u64,
    /// Folder for log.mcap, summary.json and report.html [default: a new out/NAME-DATE-TIME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Join the parts of a campaign; the result is byte for byte that of an undivided campaign.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand campaign merge out/gusts/part-*.parquet --out out/gusts")]
pub(crate) struct CampaignMergeArgs {
    /// All parts, in any order.
    #[arg(required = true, value_name = "PART")]
    pub parts: Vec<PathBuf>,
    /// Folder for flights.parquet and report.html.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

fn width(text: &str) -> Result<f64, String> {
    let value: f64 =
        text.parse().map_err(|_| "a number between 0 and 1 is expected, for example 0.02".to_string())?;
    if value > 0.0 && value < 1.0 {
        Ok(value)
    } else {
        Err(format!("a width between 0 and 1 is expected, not {text}"))
    }
}
