//! What may be changed in a launch file without editing it.

use clap::{Args, ValueEnum};

use super::quantity::seconds;

/// Who keeps the time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ModeArg {
    /// The plant wakes at absolute deadlines; a late command is a miss.
    Realtime,
    /// The plant waits for each command: runs as fast as the processes allow.
    Lockstep,
}

/// What carries the messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum TransportArg {
    /// Shared memory on one host.
    Iceoryx2,
    /// A network.
    Zenoh,
    /// All nodes in one process and one thread.
    Inproc,
}

impl ModeArg {
    /// The word as a launch file has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Realtime => "realtime",
            Self::Lockstep => "lockstep",
        }
    }
}

impl TransportArg {
    /// The word as a launch file has it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Iceoryx2 => "iceoryx2",
            Self::Zenoh => "zenoh",
            Self::Inproc => "inproc",
        }
    }
}

/// What may be changed in a launch file without editing it.
#[derive(Debug, Clone, PartialEq, Default, Args)]
pub(crate) struct OverrideArgs {
    /// Timing mode.
    #[arg(long)]
    pub mode: Option<ModeArg>,
    /// Transport of the messages.
    #[arg(long)]
    pub transport: Option<TransportArg>,
    /// Duration of the run in bench time, in seconds or with a unit ("2 min").
    #[arg(long, value_name = "TIME", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Seed of every random number.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// In lockstep, longest wait for a command, in seconds or with a unit [default: as long as the nodes live].
    #[arg(long, value_name = "TIME", value_parser = seconds, allow_negative_numbers = true)]
    pub answer_timeout: Option<f64>,
    /// Set any key of the launch file, for example controller.law=lqr or effects.0.at_s=3; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}
