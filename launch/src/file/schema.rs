//! The structure of a launch file. `docs/launch-file.md` is its manual.

use std::collections::BTreeMap;

use serde::de::{Error, IgnoredAny};
use serde::{Deserialize, Deserializer};
use whirlstand_bridge::config::{BridgeKind, BridgeOptions};
use whirlstand_bus::Transport;
use whirlstand_control::{Selector, VibrationModel, Weights};
use whirlstand_nodes::config::{
    ControllerConfig, Engine, EstimatorKind, Mode, PlantConfig, RealtimeOptions, Role,
};

use super::amount::{Amount, Bytes, Seconds, hertz};

/// A launch file as it is written; [`super::plan`] makes a runnable bench of it.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LaunchFile {
    /// Name of the bench; by default the name of the file.
    pub name: Option<String>,
    /// Description of the bench in one line.
    #[serde(default)]
    pub description: String,
    /// Built-in vehicle, or a path relative to the launch file.
    pub vehicle: String,
    /// Vehicle model used by law and filter: built-in, or a path relative to the launch file. By default the
    /// vehicle itself.
    #[serde(default)]
    pub model: Option<String>,
    /// Clock of the loop: lockstep or real time.
    #[serde(default = "realtime")]
    pub mode: Mode,
    /// Transport of the messages.
    #[serde(default = "iceoryx2")]
    pub transport: Transport,
    /// Rate of the loop, Hz.
    #[serde(default = "rate", deserialize_with = "hertz")]
    pub rate_hz: f64,
    /// Bench time of the run.
    #[serde(default = "duration")]
    pub duration_s: Seconds,
    /// Seed of every random number.
    #[serde(default = "seed")]
    pub seed: u64,
    /// Effects, added to those of the vehicle. They are read one by one so that errors name their line.
    #[serde(default)]
    pub effects: Vec<IgnoredAny>,
    #[serde(default)]
    pub plant: PlantSection,
    #[serde(default)]
    pub estimator: EstimatorSection,
    pub controller: ControllerConfig,
    /// Steps of the reference: `at_s` and values by state or output.
    #[serde(default)]
    pub setpoint: Vec<BTreeMap<String, Amount>>,
    /// Steps of the stick: `at_s` and values by input.
    #[serde(default)]
    pub stick: Vec<BTreeMap<String, Amount>>,
    #[serde(default)]
    pub recorder: RecorderSection,
    /// Options of single nodes, and programs that replace or join them.
    #[serde(default)]
    pub nodes: BTreeMap<String, NodeSection>,
    /// Options of the bridge that a node requests.
    #[serde(default)]
    pub bridge: BridgeOptions,
    #[serde(default)]
    pub zenoh: ZenohSection,
    #[serde(default)]
    pub security: SecuritySection,
    /// Options of the mirror, which compares the flight with the vehicle file.
    pub mirror: Option<MirrorSection>,
    /// A page that shows the bench while it flies.
    pub live: Option<LiveSection>,
    /// Expectations that are checked at the end; read by [`super::expect`].
    #[serde(default)]
    pub expect: BTreeMap<String, IgnoredAny>,
    /// Several runs of the bench, compared in one report.
    #[serde(default)]
    pub variants: Vec<VariantSection>,
}

/// `[estimator]` as it is written.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct EstimatorSection {
    pub kind: EstimatorKind,
    /// How the filter models declared vibration.
    pub vibration: VibrationModel,
    /// Density of process noise on each state, SI: its unit is composite, so no unit can be written.
    pub process_noise: Option<Weights>,
    pub bias: Option<Vec<Selector>>,
    /// Initial standard deviation of a bias, in the unit of the biased sensors.
    pub bias_std: Option<Amount>,
    /// Random walk of a bias: its standard deviation after the first second, in the unit of the biased
    /// sensors.
    pub bias_walk: Option<Amount>,
    pub input_bias: Vec<Selector>,
    /// Initial standard deviation of an input offset, in the unit of the offset inputs.
    pub input_bias_std: Option<Amount>,
    /// Random walk of an offset: its standard deviation after the first second, in the unit of the offset
    /// inputs.
    pub input_bias_walk: Option<Amount>,
    pub outputs: Option<Vec<Selector>>,
}

impl LaunchFile {
    /// Whether an autopilot takes the place of estimator and controller.
    pub fn has_autopilot(&self) -> bool {
        self.nodes.values().filter_map(|n| n.bridge).any(|bridge| !bridge.is_vehicle())
    }
}

/// `[plant]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct PlantSection {
    /// Engine state, which sets the amplitude of the vibration.
    pub engine: Engine,
    /// Initial states by name.
    pub initial: BTreeMap<String, Amount>,
    /// Consecutive deadline misses until the failsafe.
    pub misses_to_failsafe: u32,
    /// Longest wall-clock wait for a command in lockstep; by default as long as the nodes live.
    pub answer_timeout_s: Option<Seconds>,
    /// Longest wall-clock wait for the other nodes before step 0. The default is 10 s, or 120 s for an autopilot,
    /// which has to start and to be armed.
    pub start_timeout_s: Option<Seconds>,
    /// Take disturbances from topic `inject`.
    pub inject: bool,
}

impl Default for PlantSection {
    fn default() -> Self {
        let node = PlantConfig::default();
        Self {
            engine: node.engine,
            initial: BTreeMap::new(),
            misses_to_failsafe: node.misses_to_failsafe,
            answer_timeout_s: node.answer_timeout_s.map(Seconds),
            start_timeout_s: None,
            inject: node.inject,
        }
    }
}

/// `[mirror]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct MirrorSection {
    /// Whether the mirror flies, so that variants can leave it out.
    pub enabled: bool,
    /// Reaction to a finding: `tell`, `failsafe` or `law`.
    pub on_finding: String,
}

impl Default for MirrorSection {
    fn default() -> Self {
        Self { enabled: true, on_finding: "tell".into() }
    }
}

/// `[live]`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct LiveSection {
    /// Address of the page: PORT, IP, IP:PORT; on loopback where no IP is given.
    pub address: String,
}

/// `[recorder]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct RecorderSection {
    /// Whether the run keeps a log.
    pub enabled: bool,
    /// Size at which the log continues in the next file.
    pub max_size: Option<Bytes>,
    /// Bench time after which the log continues in the next file.
    pub max_duration: Option<Seconds>,
    /// Number of files that are kept, the most recent ones.
    pub segments: Option<u32>,
}

impl Default for RecorderSection {
    fn default() -> Self {
        Self { enabled: true, max_size: None, max_duration: None, segments: None }
    }
}

/// `[nodes.NAME]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct NodeSection {
    /// Program and arguments that replace the built-in node, or run as a node of a new name.
    pub exec: Option<Vec<String>>,
    /// Kind of real hardware that replaces the node.
    pub bridge: Option<BridgeKind>,
    /// Additional environment variables for `exec`.
    pub env: BTreeMap<String, String>,
    /// How the launcher learns that the node is ready.
    pub ready: Ready,
    /// Whether the node runs elsewhere and is started by hand with `whirlstand node`; the launcher does not
    /// start it.
    pub external: bool,
    /// Zenoh endpoints that this node listens on instead of those of `[zenoh]`.
    pub listen: Vec<String>,
    /// Zenoh endpoints that this node connects to, beside those of `[zenoh]`.
    pub connect: Vec<String>,
    /// Reaction to the death of the node.
    pub restart: Restart,
    /// Most restarts of the node.
    pub max_restarts: u32,
    /// Longest time until the node is ready.
    pub ready_timeout_s: Seconds,
    /// Longest silence of a node that publishes `Health`. After it the node is killed and counts as failed.
    pub hang_timeout_s: Seconds,
    /// Time between the request to end (SIGTERM) and the kill (SIGKILL); see [`Self::stop_timeout_s`].
    pub stop_timeout_s: Option<Seconds>,
    /// Priority under SCHED_FIFO, 1 to 99.
    #[serde(deserialize_with = "priority")]
    pub priority: Option<u8>,
    /// CPUs that the node may use; empty: all.
    pub cpus: Vec<usize>,
    /// Lock all memory.
    pub lock_memory: bool,
}

impl NodeSection {
    /// Most starts of the node in a run.
    pub fn starts(&self) -> u32 {
        match self.restart {
            Restart::Never => 1,
            Restart::OnFailure => self.max_restarts.saturating_add(1),
        }
    }

    /// Time between the request to end and the kill, s. By default 3 s, and half a minute for a recorder, which
    /// has to write its log to a disk that may be busy; a kill would lose the messages that it holds.
    pub fn stop_timeout_s(&self, role: Option<Role>) -> f64 {
        let usual = if role == Some(Role::Recorder) { 30.0 } else { 3.0 };
        self.stop_timeout_s.map_or(usual, |stated| stated.0)
    }

    /// The real-time options that the node requests from the operating system.
    pub fn realtime(&self) -> RealtimeOptions {
        RealtimeOptions { priority: self.priority, cpus: self.cpus.clone(), lock_memory: self.lock_memory }
    }
}

/// Reads a priority of any size, so that one out of range gets a clear message.
fn priority<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    let asked = i64::deserialize(deserializer)?;
    let known = u8::try_from(asked).ok().filter(|p| (1..=99).contains(p));
    known.map(Some).ok_or_else(|| {
        D::Error::custom(format!("a priority of SCHED_FIFO, from 1 to 99, is expected, not {asked}"))
    })
}

impl Default for NodeSection {
    fn default() -> Self {
        Self {
            exec: None,
            bridge: None,
            env: BTreeMap::new(),
            ready: Ready::Notify,
            external: false,
            listen: Vec::new(),
            connect: Vec::new(),
            restart: Restart::OnFailure,
            max_restarts: 3,
            ready_timeout_s: Seconds(15.0),
            hang_timeout_s: Seconds(5.0),
            stop_timeout_s: None,
            priority: None,
            cpus: Vec::new(),
            lock_memory: false,
        }
    }
}

/// How a node reports that it is ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Ready {
    /// The node sends `READY=1` to `NOTIFY_SOCKET`, as under systemd.
    Notify,
    /// The node is ready as soon as it has started.
    Start,
}

/// What happens when a node dies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Restart {
    /// The run ends.
    Never,
    /// The node is started again, `max_restarts` times at most.
    OnFailure,
}

/// `[zenoh]`.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct ZenohSection {
    /// Endpoints on which every node listens, with port 0 so that each takes a free one; empty: on the
    /// loopback.
    pub listen: Vec<String>,
    /// Endpoints to which every node connects, besides the other nodes of the bench.
    pub connect: Vec<String>,
    /// Zenoh's own configuration file (JSON5), relative to the launch file.
    pub config: Option<String>,
}

/// `[security]`: who may join a bench over Zenoh.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct SecuritySection {
    /// Mode of protection. By default a secret, where that can protect the bench.
    pub mode: Option<SecurityMode>,
    /// Folder that `whirlstand keys new` has made, relative to the launch file.
    pub keys: Option<String>,
}

/// How a bench is protected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum SecurityMode {
    /// No protection.
    Open,
    /// Keys that the launcher makes for one run, on one host.
    Secret,
    /// Keys that were made before, on several hosts.
    Tls,
}

/// `[[variants]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VariantSection {
    /// Name of the run; also its folder.
    pub name: String,
    /// The differences: dotted keys and values, as with `--set`.
    #[serde(default)]
    pub set: toml::Table,
}

fn realtime() -> Mode {
    Mode::Realtime
}

fn iceoryx2() -> Transport {
    Transport::Iceoryx2
}

fn rate() -> f64 {
    200.0
}

fn duration() -> Seconds {
    Seconds(12.0)
}

fn seed() -> u64 {
    1
}
