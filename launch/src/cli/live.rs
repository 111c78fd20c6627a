//! Options of the calls that speak to a running bench, or show one: inject, set, echo, watch, play.

use std::num::NonZeroU64;
use std::path::PathBuf;

use clap::Args;
use whirlstand_live::{Address, AddressError, FOXGLOVE_PORT};

use super::JsonArg;
use super::overrides::OverrideArgs;
use super::quantity::seconds;

/// A bench that runs: of this user on this machine, or on another host.
#[derive(Debug, Args)]
pub(crate) struct WhichBenchArgs {
    /// Name of the bench, as `run` prints it.
    #[arg(value_name = "BENCH")]
    pub name: String,
    /// Launch file of a bench on another host, which says where its nodes listen and where the keys are.
    #[arg(long, value_name = "LAUNCH")]
    pub launch: Option<String>,
    /// Zenoh endpoint of a node on another host that is not in the launch file; may be repeated.
    #[arg(long, value_name = "ENDPOINT", requires = "launch")]
    pub connect: Vec<String>,
    #[command(flatten)]
    pub overrides: OverrideArgs,
}

/// Disturb the vehicle of a running bench: a gust on one or more states.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand run quadrotor --bench lab --set plant.inject=true\n  \
    whirlstand inject lab roll_rate=\"150 deg/s^2\" pitch_rate=\"-80 deg/s^2\" --for \"200 ms\"\n\n\
    A gust is added to the derivative of the state, from the next step on, for its length in bench time, in \
    addition to all others. Exit code 2 when the bench refuses it.")]
pub(crate) struct InjectArgs {
    #[command(flatten)]
    pub bench: WhichBenchArgs,
    /// State and size, with the unit of the state per second.
    #[arg(required = true, value_name = "STATE=SIZE")]
    pub gusts: Vec<String>,
    /// How long it acts, in bench time, in seconds or with a unit.
    #[arg(long = "for", value_name = "TIME", value_parser = seconds, default_value = "200 ms")]
    pub length: f64,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Change a running bench: a setpoint, the gain of the law, the state of the engine, the end of the run.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand run quadrotor --bench lab --set plant.inject=true --set controller.pilot=true\n  \
    whirlstand set lab setpoint.roll=\"5 deg\" setpoint.pitch=0rad\n  \
    whirlstand set lab gain=1.5 engine=on\n\n\
    A setpoint replaces the launch file's. The gain, 0.1 to 10, is a factor on all feedback. The engine is off, on \
    (on the ground) or flying, and sets the vibration that the sensors feel. effect.N switches the Nth effect, \
    those of the vehicle file first, if it has from_s or until_s. run=stop ends the run cleanly. Exit code 2 when \
    the bench refuses one.")]
pub(crate) struct SetArgs {
    #[command(flatten)]
    pub bench: WhichBenchArgs,
    /// setpoint.STATE=VALUE, gain=FACTOR, engine=off|on|flying, effect.N=on|off or run=stop.
    #[arg(required = true, value_name = "KEY=VALUE")]
    pub settings: Vec<String>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Print the messages of a topic of a running bench until Ctrl-C or its end.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand echo lab imu\n  \
    whirlstand echo lab truth --count 1 --json\n\n\
    Topics: imu, odometry, outputs, estimate, command, setpoint, truth, disturbance, finding, sent, autopilot, \
    health, progress, adjusted, and from outside inject, pilot, adjust, stick. Angles are in degrees; JSON (one \
    message per line) is in SI units.")]
pub(crate) struct EchoArgs {
    #[command(flatten)]
    pub bench: WhichBenchArgs,
    /// The topic.
    pub topic: String,
    /// Stop after N messages.
    #[arg(long, value_name = "N")]
    pub count: Option<NonZeroU64>,
    #[command(flatten)]
    pub json: JsonArg,
}

/// Show a running bench: on a page for the browser, or in the terminal.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand run quadrotor --bench lab --duration 10min\n  \
    whirlstand watch lab\n  \
    whirlstand watch lab --tui\n  \
    whirlstand watch lab --launch lab.toml    # from another host\n\n\
    The page offers the same controls as `whirlstand inject` and `set`, if the bench allows them. Served beyond \
    this machine (--listen 0.0.0.0), its address includes a token. It ends with the bench or on Ctrl-C; in the \
    terminal, q quits.")]
pub(crate) struct WatchArgs {
    #[command(flatten)]
    pub bench: WhichBenchArgs,
    /// In the terminal instead of a browser.
    #[arg(long, conflicts_with = "listen")]
    pub tui: bool,
    /// Where the page is served: PORT, IP or IP:PORT [default: 127.0.0.1, port 8480 or a free one]
    #[arg(long, value_name = "ADDR", default_value = "", hide_default_value = true)]
    pub listen: Address,
    /// Serve the bench to Foxglove as well: PORT, IP or IP:PORT [default: 127.0.0.1, port 8765 or a free one]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "", value_parser = foxglove_address, conflicts_with = "tui")]
    pub foxglove: Option<Address>,
}

/// Where Foxglove finds the bench.
pub(super) fn foxglove_address(text: &str) -> Result<Address, AddressError> {
    Address::parse(text, FOXGLOVE_PORT)
}

/// Replay a finished log as if it were flying now, at any speed.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    whirlstand play out/quadrotor-2026-11-23-120000/log.mcap\n  \
    whirlstand play out/quadrotor-2026-11-23-120000 --speed 10\n\n\
    Speed, pause and position can be changed on the page. Ctrl-C ends it; in the terminal, it ends with the log or on q.")]
pub(crate) struct PlayArgs {
    /// A log of a bench, or the folder of its run.
    pub log: PathBuf,
    /// Playback speed: seconds of bench time per second, 0.01 to 1000.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub speed: f64,
    /// In the terminal instead of a browser.
    #[arg(long, conflicts_with = "listen")]
    pub tui: bool,
    /// Where the page is served: PORT, IP or IP:PORT [default: 127.0.0.1, port 8480 or a free one]
    #[arg(long, value_name = "ADDR", default_value = "", hide_default_value = true)]
    pub listen: Address,
}
