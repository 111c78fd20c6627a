//! The call `soak`: what is done to a bench, how often and for how long.

use clap::{Args, ValueEnum};

use super::json::JsonArg;
use super::overrides::OverrideArgs;
use super::quantity::seconds;

/// Inject faults into a bench at random times, again and again, and check that it survives.
///
/// After each fault the loop must recover, without losing messages or log steps that the fault should not affect and
/// without accepting forged messages. Exit code 1 on any loss.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand soak --fault kill --rounds 50 --seed 1 --json soak.json\n  \
    whirlstand soak --fault disk --rounds 10 --lasting 3\n  \
    whirlstand soak --fault forge --transport zenoh\n  \
    whirlstand soak mine.toml --fault flood --lasting 10")]
pub(crate) struct SoakArgs {
    /// Built-in launch file or path [default: quadrotor]
    pub launch: Option<String>,
    /// The fault to inject.
    #[arg(long, value_enum, default_value_t = FaultArg::Kill)]
    pub fault: FaultArg,
    /// Number of faults: per node (kill, stop, memory) or for the whole bench.
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub rounds: u32,
    /// How long a fault lasts, in seconds or with a unit; not used for kill.
    #[arg(long, visible_alias = "stop-for", value_name = "TIME", value_parser = seconds, default_value = "2",
          allow_negative_numbers = true)]
    pub lasting: f64,
    #[command(flatten)]
    pub overrides: OverrideArgs,
    /// Only these nodes, for kill, stop and memory; may be repeated [default: every node]
    #[arg(long = "node", value_name = "NODE")]
    pub nodes: Vec<String>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// What `soak` does to a bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FaultArg {
    /// A node gets SIGKILL.
    Kill,
    /// A node gets SIGSTOP, and SIGCONT later.
    Stop,
    /// The log's file system is full; if the soak cannot mount its own, the recorder is kept from writing.
    Disk,
    /// A node cannot allocate any more memory.
    Memory,
    /// A stranger forges messages: over zenoh without a key of the bench, otherwise on a bridge's UDP ports.
    Forge,
    /// Ten thousand messages per second: garbage on a bridge's UDP ports, otherwise disturbances on the topic inject.
    Flood,
    /// Every processor is busy.
    Load,
}

impl FaultArg {
    /// The word as the command line has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::Stop => "stop",
            Self::Disk => "disk",
            Self::Memory => "memory",
            Self::Forge => "forge",
            Self::Flood => "flood",
            Self::Load => "load",
        }
    }

    /// Whether it is done to one node at a time, and not to the bench.
    pub fn is_of_a_node(self) -> bool {
        matches!(self, Self::Kill | Self::Stop | Self::Memory)
    }
}
