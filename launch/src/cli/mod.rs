//! The command line: every call, option and help text of `whirlstand`.

mod bench_tune;
mod blind;
mod campaign;
mod files;
mod json;
mod keys;
mod live;
mod machine;
mod mirror;
mod overrides;
mod quantity;
mod records;
mod relay;
mod shell;
mod soak;
mod tune;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use whirlstand_live::Address;

pub(crate) use bench_tune::BenchTuneArgs;
pub(crate) use blind::{
    BlindArgs, BlindCase, BlindCommand, BlindGenerator, BlindLoop, BlindMergeArgs, BlindRunArgs,
};
pub(crate) use campaign::{
    CampaignArgs, CampaignCommand, CampaignFlyArgs, CampaignMergeArgs, CampaignReplayArgs,
};
pub(crate) use files::{
    DesignArgs, LaunchCommand, LogCommand, SimulateArgs, VehicleCommand, VehicleFmuArgs, VehicleNewArgs,
};
pub(crate) use json::JsonArg;
pub(crate) use keys::{KeysCommand, KeysNewArgs, KeysShowArgs};
pub(crate) use live::{EchoArgs, InjectArgs, PlayArgs, SetArgs, WatchArgs, WhichBenchArgs};
pub(crate) use machine::{BenchArgs, BenchCommand, DoctorArgs};
pub(crate) use mirror::BenchMirrorArgs;
pub(crate) use overrides::{ModeArg, OverrideArgs, TransportArg};
use quantity::seconds;
pub(crate) use records::{
    CompareArgs, DiagnoseArgs, ExciteArgs, ExciteKind, IdentifyArgs, IdentifyMethod, IdentifyNoise,
    RecordArgs,
};
pub(crate) use relay::{RelayCommand, RelayRos2Args, RelayUdpArgs};
pub(crate) use shell::{CompletionsArgs, ManArgs};
pub(crate) use soak::{FaultArg, SoakArgs};
pub(crate) use tune::{TuneArgs, TunedLaw};

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
    after_help = "Exit codes: 0 success; 1 a run or an expectation failed, or two logs differ; 2 an error that you \
                  can fix; 3 the time budget was used up; 128 + n ended by signal n, with the results so far.\n\n\
                  Examples:\n  \
                  whirlstand run                                    the quadrotor under sliding-mode control\n  \
                  whirlstand run quadrotor-compare --mode lockstep  pole placement, sliding mode and LQR side by side\n  \
                  whirlstand launch show quadrotor > mine.toml      a launch file to start from\n  \
                  whirlstand doctor                                 is this machine fit for real time?"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// Log level on standard error: error, warn, info, debug, trace, or a filter as in RUST_LOG.
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
    Tune(TuneArgs),
    Excite(ExciteArgs),
    Blind(BlindArgs),
    Campaign(CampaignArgs),
    /// Inspect logs: show what they contain, export them as CSV, find where two of them differ.
    #[command(subcommand)]
    Log(LogCommand),
    /// Draft, list, show, check and export vehicle files.
    #[command(subcommand)]
    Vehicle(VehicleCommand),
    /// List and show launch files.
    #[command(subcommand)]
    Launch(LaunchCommand),
    /// Manage keys of benches over Zenoh: create them for several hosts, show what a program needs to join a running
    /// bench.
    #[command(subcommand)]
    Keys(KeysCommand),
    Inject(InjectArgs),
    Set(SetArgs),
    Echo(EchoArgs),
    Watch(WatchArgs),
    Play(PlayArgs),
    Bench(BenchArgs),
    /// Check real hardware that replaces a node.
    #[command(subcommand)]
    Bridge(BridgeCommand),
    /// Connect a controller over UDP or in ROS 2.
    #[command(subcommand)]
    Relay(RelayCommand),
    Doctor(DoctorArgs),
    Soak(SoakArgs),
    Clean(CleanArgs),
    Completions(CompletionsArgs),
    Man(ManArgs),
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
    /// Folder of the nodes' notify sockets, by which what they started is known.
    #[arg(long)]
    pub sockets: Option<PathBuf>,
    /// A file or folder that goes with the launcher; may be repeated.
    #[arg(long)]
    pub remove: Vec<PathBuf>,
}

/// Remove what killed runs left on this machine: shared memory, sockets, keys, name locks. Running benches are not
/// touched.
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

/// Run a bench: start its nodes, supervise them, and write a log and a report.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand run\n  \
    whirlstand run quadrotor-smc --transport zenoh --duration 20\n  \
    whirlstand run --live --set plant.inject=true --set controller.pilot=true\n  \
    whirlstand run mine.toml --set controller.law=lqr --set 'plant.initial.roll=\"10 deg\"' --out out/lqr\n\n\
    Ctrl-C stops the run cleanly: the inputs go to neutral, the recorder closes the log, the report is written.")]
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
    /// Serve a page that shows the bench while it flies: PORT, IP or IP:PORT [default: 127.0.0.1, port 8480 or a free one]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "")]
    pub live: Option<Address>,
    /// Serve the bench to Foxglove or Lichtblick while it flies: PORT, IP or IP:PORT [default: 127.0.0.1, port 8765 or a free one]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "", value_parser = live::foxglove_address)]
    pub foxglove: Option<Address>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Run one node: used by the launcher, or by hand on another host.
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
    /// Launch file that defines the node [default: quadrotor]
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

/// What can be done with a bridge.
#[derive(Debug, Subcommand)]
pub(crate) enum BridgeCommand {
    Check(BridgeCheckArgs),
}

/// Check, axis by axis, live and disarmed, that signs, scales and channels are right, and say which are wrong.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    whirlstand bridge check plant --launch quad-on-usb.toml\n\n\
    For a vehicle: take the propellers off, lift it and follow the instructions; then, if you agree, each channel is \
    moved by 100 us and read back. An armed vehicle is refused.\n  \
    For an autopilot: the simulated vehicle is tilted about each axis, and the attitude that the autopilot reports \
    to its ground station must follow.")]
pub(crate) struct BridgeCheckArgs {
    /// The bridge node: plant or controller.
    pub node: String,
    /// Launch file with the bridge.
    #[arg(long, value_name = "LAUNCH")]
    pub launch: String,
    /// How long to wait for the vehicle and for each axis, in seconds or with a unit.
    #[arg(long, value_name = "TIME", value_parser = seconds, default_value = "20")]
    pub timeout: f64,
    /// For a vehicle: the propellers are off, and its channels may move. Otherwise this is asked on a terminal, and
    /// without one nothing moves.
    #[arg(long)]
    pub yes: bool,
    /// For a vehicle: skip the channels and only listen.
    #[arg(long, conflicts_with = "yes")]
    pub no_outputs: bool,
    /// For an autopilot: where it sends telemetry to its ground station [default: udpin://0.0.0.0:14550, Betaflight:
    /// tcpout://127.0.0.1:5761]
    #[arg(long, value_name = "ADDRESS")]
    pub telemetry: Option<String>,
    /// For an autopilot: arm it as well, and check that its outputs counteract the tilt.
    #[arg(long)]
    pub arm: bool,
    /// Set any key of the launch file; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn units_and_files_are_taken_by_the_calls_that_did_not() {
        for line in [
            "excite quadrotor --duration 2min --rate 0.1kHz --lowest 0.1Hz --highest 2Hz --json",
            "design quadrotor --law lqr --rate 1kHz --json design.json",
            "compare log.csv --vehicle quadrotor --from 500ms --to 2min --period 5ms --horizon 2s --json",
            "identify log.csv --vehicle quadrotor --delay roll=60ms --hold-out 1min:84s",
            "bench --seconds 500ms --realtime-seconds 1min --json",
            "soak --fault stop --lasting 500ms --json",
            "blind --length 30s:2min --rate 0.1kHz,200 --json",
            "run --json summary.json",
            "run --live --set plant.inject=true",
            "run --live 0.0.0.0:9000 --json",
            "watch lab --tui",
            "play out/lab/log.mcap --speed 0.5 --listen 0",
            "doctor --json doctor.json",
        ] {
            let words = ["whirlstand"].into_iter().chain(line.split(' '));
            if let Err(error) = Cli::try_parse_from(words) {
                panic!("{line}: {error}");
            }
        }
        let refused =
            Cli::try_parse_from(["whirlstand", "bench", "--priority", "-1"]).unwrap_err().to_string();
        assert!(
            refused.contains("a priority of SCHED_FIFO, from 1 to 99, is expected, not '-1'"),
            "{refused}"
        );
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
                let bare = names.iter().any(|name| ["S", "HZ"].contains(&name.as_str()));
                assert!(!bare, "{} {}", call.get_name(), argument.get_id());
            }
        });
    }
}
