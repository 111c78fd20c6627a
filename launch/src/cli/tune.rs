//! Options of `whirlstand tune`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use whirlstand_nodes::config::LawKind;

use super::{JsonArg, RecordArgs};

/// Improve a control law from a record: diagnose it, extend the vehicle, design a new law, and compare both over many
/// flights.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand tune out/flight --launch mine.toml --out out/tuned\n  \
    whirlstand tune flight.ulg --launch mine.toml --law lqr --draws 500 --out out/tuned --json -\n\n\
    --out receives tuned.toml (a launch file to run), vehicle.toml (the model for which law and filter are \
    designed) and report.html. The old law is kept unless the gain is certain.")]
pub(crate) struct TuneArgs {
    /// MCAP, CSV, PX4 ULog, ArduPilot DataFlash or Betaflight blackbox; several are diagnosed together.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Built-in launch file or path: vehicle, law, disturbances and expectations of the flights.
    #[arg(long)]
    pub launch: String,
    /// Law to design instead of the launch file's.
    #[arg(long, value_enum)]
    pub law: Option<TunedLaw>,
    /// Number of draws flown with each law.
    #[arg(long, default_value_t = 200)]
    pub draws: u64,
    /// Retune the weights of the new law against the launch file's expectations: R and the rates' Q of lqr, the
    /// bandwidth of ppc, the boundary layer of smc. Tuning and evaluation use different draws.
    #[arg(long)]
    pub retune: bool,
    /// Largest peak sensitivity, filter included, that --retune accepts.
    #[arg(long, default_value_t = TuneArgs::MAX_SENSITIVITY, requires = "retune", value_name = "PEAK")]
    pub max_sensitivity: f64,
    #[command(flatten)]
    pub part: RecordArgs,
    /// Vehicle file of the true vehicle, if known: both laws and one designed for it are flown on it as well.
    #[arg(long, value_name = "VEHICLE")]
    pub truth: Option<String>,
    /// Folder for tuned.toml, vehicle.toml and report.html.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

impl TuneArgs {
    /// Peak of the sensitivity where no other is told.
    pub const MAX_SENSITIVITY: f64 = 1.6;
}

/// A law that can be designed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum TunedLaw {
    /// Linear-quadratic regulator.
    Lqr,
    /// Pole placement.
    Ppc,
    /// Sliding mode.
    Smc,
}

impl From<TunedLaw> for LawKind {
    fn from(law: TunedLaw) -> Self {
        match law {
            TunedLaw::Lqr => Self::Lqr,
            TunedLaw::Ppc => Self::Ppc,
            TunedLaw::Smc => Self::Smc,
        }
    }
}
