//! The command line: every call, option and help text of `whirlstand`.

mod blind;
mod files;
mod json;
mod keys;
mod live;
mod quantity;
mod records;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

pub(crate) use blind::{BlindArgs, BlindCase, BlindGenerator, BlindLoop};
pub(crate) use files::{DesignArgs, LaunchCommand, LogCommand, SimulateArgs, VehicleCommand, VehicleNewArgs};
pub(crate) use json::JsonArg;
pub(crate) use keys::{KeysCommand, KeysNewArgs, KeysShowArgs};
pub(crate) use live::{EchoArgs, InjectArgs, SetArgs};
use quantity::seconds;
pub(crate) use records::{
    CompareArgs, DiagnoseArgs, ExciteArgs, ExciteKind, IdentifyArgs, IdentifyMethod, IdentifyNoise,
};

/// A hardware-in-the-loop bench for small VTOL control.
///
/// Plant, estimator and controller run as separate processes over shared memory or a network; any of them can
/// be replaced by one line of a launch file. Measured records are compared with the simulation.
#[derive(Debug, Parser)]
#[command(
    name = "whirlstand",
    version,
    propagate_version = true,
    max_term_width = 110,
    after_help = "Exit codes: 0 all well; 1 a run or an expectation failed, or two logs differ; 2 something that you can mend.\n\n\
                  Examples:\n  \
                  whirlstand run                                    the quadrotor under sliding-mode control\n  \
                  whirlstand run quadrotor-compare --mode lockstep  pole placement, sliding mode and LQR side by side\n  \
                  whirlstand launch show quadrotor > mine.toml      a launch file to start from\n  \
                  whirlstand doctor                                 is this machine fit for real time?"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// What to tell on standard error: error, warn, info, debug, trace, or a filter as in RUST_LOG.
    #[arg(long, global = true, value_name = "LEVEL")]
    pub log_level: Option<String>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Run(RunArgs),
    Node(NodeArgs),
    Design(DesignArgs),
    Simulate(SimulateArgs),
    Compare(CompareArgs),
    Identify(IdentifyArgs),
    Diagnose(DiagnoseArgs),
    Excite(ExciteArgs),
    Blind(BlindArgs),
    /// Look into logs: what they hold, as CSV, and where two of them differ.
    #[command(subcommand)]
    Log(LogCommand),
    /// Draft, list, show and check vehicle files.
    #[command(subcommand)]
    Vehicle(VehicleCommand),
    /// List and show launch files.
    #[command(subcommand)]
    Launch(LaunchCommand),
    /// Keys of benches over Zenoh: make them for several hosts, show what a program needs to join a running bench.
    #[command(subcommand)]
    Keys(KeysCommand),
    Inject(InjectArgs),
    Set(SetArgs),
    Echo(EchoArgs),
    Bench(BenchArgs),
    /// Look at real hardware that takes a node's place.
    #[command(subcommand)]
    Bridge(BridgeCommand),
    Doctor(DoctorArgs),
    Soak(SoakArgs),
    Clean(CleanArgs),
    #[command(hide = true)]
    Guard(GuardArgs),
    #[command(hide = true)]
    Exec(ExecArgs),
}

/// Ask for real-time options and become another program: what the launcher starts for `exec` nodes that want them.
#[derive(Debug, Args)]
pub(crate) struct ExecArgs {
    /// Options as JSON.
    #[arg(long)]
    pub realtime: String,
    /// Program and arguments.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, required = true)]
    pub command: Vec<String>,
}

/// End and remove what a killed launcher leaves: what the launcher starts beside the nodes.
#[derive(Debug, Args)]
pub(crate) struct GuardArgs {
    /// The bench.
    #[arg(long)]
    pub bench: String,
    /// Time from SIGTERM to SIGKILL, s.
    #[arg(long)]
    pub grace: f64,
    /// A file or folder that goes with the launcher; may be repeated.
    #[arg(long)]
    pub remove: Vec<PathBuf>,
}

/// Remove what killed runs left on this machine: shared memory, sockets, claims of names. Live benches are not touched.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand clean --dry-run\n  \
    whirlstand clean --json\n\n\
    Every `whirlstand run` does the same when it starts. Exit code 1 when something could not be removed.")]
pub(crate) struct CleanArgs {
    /// Only list what would be removed.
    #[arg(long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Who keeps the time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ModeArg {
    /// The plant wakes at absolute deadlines; a late command is a miss.
    Realtime,
    /// The plant waits for each command: as fast as the processes can go.
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

/// Run a bench: start its nodes, watch them, and leave a log and a report.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand run\n  \
    whirlstand run quadrotor-smc --transport zenoh --duration 20\n  \
    whirlstand run mine.toml --set controller.law=lqr --set 'plant.initial.roll=\"10 deg\"' --out out/lqr\n\n\
    Ctrl-C ends the run in order: the plant goes to neutral, the recorder closes the log, the report is written.")]
pub(crate) struct RunArgs {
    /// Built-in launch file (see `whirlstand launch list`) or a path; without it, the quadrotor under
    /// sliding-mode control with a disturbance at 6 s.
    pub launch: Option<String>,
    /// Record nothing: no log, and no report of what the vehicle did.
    #[arg(long)]
    pub no_log: bool,
    #[command(flatten)]
    pub overrides: OverrideArgs,
    /// Folder for log.mcap, summary.json and report.html; one run at a time [default: a new out/NAME-DATE-TIME]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Name of the bench, for nodes that are started elsewhere; one run at a time [default: a new one for each run]
    #[arg(long, value_name = "NAME")]
    pub bench: Option<String>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// What may be changed in a launch file without editing it.
#[derive(Debug, Clone, Default, Args)]
pub(crate) struct OverrideArgs {
    /// Who keeps the time.
    #[arg(long)]
    pub mode: Option<ModeArg>,
    /// What carries the messages.
    #[arg(long)]
    pub transport: Option<TransportArg>,
    /// Bench time of the run, in seconds or with a unit ("2 min").
    #[arg(long, value_name = "TIME", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Seed of every random number.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// In lockstep, longest wait for a command, in seconds or with a unit [default: as long as the nodes live].
    #[arg(long, value_name = "TIME", value_parser = seconds, allow_negative_numbers = true)]
    pub answer_timeout: Option<f64>,
    /// Sets any key of the launch file, for example controller.law=lqr or effects.0.magnitude=3; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Run one node: for the launcher, and by hand on another host.
#[derive(Debug, Args)]
#[command(
    after_help = "Example, the controller on a second host (the bench runs there as `--bench NAME`):\n  \
    whirlstand node controller --launch two-hosts.toml --bench lab --listen tls/192.0.2.2:7447"
)]
pub(crate) struct NodeArgs {
    /// plant, estimator, controller or recorder.
    pub kind: String,
    /// Resolved configuration as JSON: a file, or - for standard input (what the launcher uses).
    #[arg(long, value_name = "FILE", conflicts_with_all = ["launch", "set", "mode", "duration", "seed"])]
    pub config: Option<PathBuf>,
    /// Launch file that the node is taken from [default: quadrotor]
    #[arg(long, value_name = "LAUNCH")]
    pub launch: Option<String>,
    /// Name of the bench, the same for all its nodes [default: WHIRLSTAND_BENCH, or the launch file's name]
    #[arg(long, value_name = "NAME")]
    pub bench: Option<String>,
    #[command(flatten)]
    pub overrides: OverrideArgs,
    /// Zenoh endpoint to connect to, for example tcp/192.0.2.7:7447; may be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Zenoh endpoint to listen on; may be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Log file of a recorder.
    #[arg(long, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

/// Measure latency, jitter and throughput beside the bare floor of this machine.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand bench lockstep recorded\n  \
    whirlstand bench realtime --realtime-seconds 60 --priority 80\n\n\
    Processes that are compared run on the same CPUs. The realtime measurement runs cyclictest (Debian: rt-tests) \
    at the same priority beside it.")]
pub(crate) struct BenchArgs {
    /// What to measure: plant, inproc, lockstep, recorded, zenoh, realtime, vehicles, autopilots [default: all]
    pub what: Vec<String>,
    /// Measure the bridges alone: wire to bus and back, beside a bare echo.
    #[arg(long)]
    pub bridge: bool,
    /// Length of each throughput measurement, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 2.0)]
    pub seconds: f64,
    /// How often each throughput is measured.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub repeat: u32,
    /// Length of the realtime measurement, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 10.0)]
    pub realtime_seconds: f64,
    /// SCHED_FIFO priority of the realtime measurement [default: none]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u8).range(1..=99))]
    pub priority: Option<u8>,
    /// CPUs of plant, estimator and controller in the lockstep measurement, and of the ring beside them [default: the
    /// scheduler decides]
    #[arg(long, value_name = "CPU,CPU,CPU", value_delimiter = ',')]
    pub cpus: Vec<usize>,
    #[command(flatten)]
    pub json: JsonArg,
    /// One process of a measurement, told on standard input what to do.
    #[arg(long, hide = true)]
    pub member: bool,
}

/// What can be done with a bridge.
#[derive(Debug, Subcommand)]
pub(crate) enum BridgeCommand {
    Check(BridgeCheckArgs),
}

/// Check axis by axis, live and disarmed, that signs, scales and channels are right, and say which is wrong.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand bridge check plant --launch quad-on-usb.toml\n\n\
    For a vehicle: lift it and follow the words; then each channel is moved by 100 us and read back. Take the propellers \
    off. An armed vehicle is refused.\n  \
    For an autopilot: the simulated vehicle is tilted about each axis, and the attitude that the autopilot tells its ground \
    station must follow.")]
pub(crate) struct BridgeCheckArgs {
    /// The node that is a bridge: plant or controller.
    pub node: String,
    /// Launch file with the bridge.
    #[arg(long, value_name = "LAUNCH")]
    pub launch: String,
    /// How long to wait for the vehicle and for each axis, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value = "20")]
    pub timeout: f64,
    /// A vehicle: leave out the channels, listen only.
    #[arg(long)]
    pub no_outputs: bool,
    /// An autopilot: where it speaks to its ground station [default: udpin://0.0.0.0:14550, Betaflight:
    /// tcpout://127.0.0.1:5761]
    #[arg(long, value_name = "ADDRESS")]
    pub telemetry: Option<String>,
    /// An autopilot: arm it as well, and see that its outputs push back.
    #[arg(long)]
    pub arm: bool,
    /// Sets any key of the launch file; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Tell whether this machine is fit for real time, and what to change.
#[derive(Debug, Args)]
pub(crate) struct DoctorArgs {
    #[command(flatten)]
    pub json: JsonArg,
}

/// Inject faults into every node of a bench at random times, again and again, and check that the bench survives.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  whirlstand soak --fault kill --rounds 50 --seed 1 --json soak.json")]
pub(crate) struct SoakArgs {
    /// Built-in launch file or path [default: quadrotor]
    pub launch: Option<String>,
    /// kill: SIGKILL; stop: SIGSTOP for --stop-for seconds, then SIGCONT.
    #[arg(long, value_enum, default_value_t = FaultArg::Kill)]
    pub fault: FaultArg,
    /// How many faults each node gets.
    #[arg(long, value_name = "N", default_value_t = 5)]
    pub rounds: u32,
    /// Length of a stop, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value_t = 2.0)]
    pub stop_for: f64,
    #[command(flatten)]
    pub overrides: OverrideArgs,
    /// Only these nodes; may be repeated [default: every node]
    #[arg(long = "node", value_name = "NODE")]
    pub nodes: Vec<String>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// What `soak` does to a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FaultArg {
    /// SIGKILL.
    Kill,
    /// SIGSTOP, later SIGCONT.
    Stop,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    /// Goes through a call and all below it.
    fn each(call: &clap::Command, look: &mut impl FnMut(&clap::Command)) {
        look(call);
        call.get_subcommands().for_each(|below| each(below, look));
    }

    #[test]
    fn json_takes_an_optional_file_wherever_it_is() {
        let mut found = 0;
        each(&Cli::command(), &mut |call| {
            for argument in call.get_arguments().filter(|a| a.get_long() == Some("json")) {
                found += 1;
                let range = argument.get_num_args().map(|n| (n.min_values(), n.max_values()));
                assert_eq!(range, Some((0, 1)), "{}", call.get_name());
            }
        });
        assert!(found > 15, "{found}");
    }

    #[test]
    fn times_and_frequencies_take_units_wherever_they_are() {
        each(&Cli::command(), &mut |call| {
            for argument in call.get_arguments() {
                let names = argument.get_value_names().unwrap_or_default();
                assert!(
                    !names.iter().any(|n| ["S", "HZ"].contains(&n.as_str())),
                    "{} {argument}",
                    call.get_name()
                );
            }
        });
    }
}
