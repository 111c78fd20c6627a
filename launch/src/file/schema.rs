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
    /// Name of the bench; the file's name without it.
    pub name: Option<String>,
    /// One line on what the bench shows.
    #[serde(default)]
    pub description: String,
    /// Built-in vehicle, or a path relative to the launch file.
    pub vehicle: String,
    /// What law and filter take the vehicle for: built-in, or a path relative to the launch file; the vehicle without it.
    #[serde(default)]
    pub model: Option<String>,
    /// What sets the pace of the loop.
    #[serde(default = "realtime")]
    pub mode: Mode,
    /// What carries the messages.
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
    /// Effects, added to the vehicle's; read one by one so that errors know their line.
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
    /// Options of single nodes, and programs that take their place or join them.
    #[serde(default)]
    pub nodes: BTreeMap<String, NodeSection>,
    /// Options of the bridge that a node asks for.
    #[serde(default)]
    pub bridge: BridgeOptions,
    #[serde(default)]
    pub zenoh: ZenohSection,
    #[serde(default)]
    pub security: SecuritySection,
    /// Holds the flight against the vehicle file.
    pub mirror: Option<MirrorSection>,
    /// A page that shows the bench while it flies.
    pub live: Option<LiveSection>,
    /// What must hold at the end; read by [`super::expect`].
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
    /// What declared vibration is taken for.
    pub vibration: VibrationModel,
    /// SI for a density of noise on each state: its unit is composite, and no text is taken for it.
    pub process_noise: Option<Weights>,
    pub bias: Option<Vec<Selector>>,
    /// In the unit of the biased sensors.
    pub bias_std: Option<Amount>,
    /// In the unit of the biased sensors: what a bias wanders in the first second.
    pub bias_walk: Option<Amount>,
    pub input_bias: Vec<Selector>,
    /// In the unit of the offset inputs.
    pub input_bias_std: Option<Amount>,
    /// In the unit of the offset inputs: what an offset wanders in the first second.
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
    /// Engine state: amplitude of the vibration.
    pub engine: Engine,
    /// Initial states by name.
    pub initial: BTreeMap<String, Amount>,
    /// Consecutive misses until the failsafe.
    pub misses_to_failsafe: u32,
    /// Longest wall-clock wait for a command in lockstep; as long as the nodes live unless it is set.
    pub answer_timeout_s: Option<Seconds>,
    /// Longest wall-clock wait for the other nodes before step 0; 10 s, or 120 s for an autopilot, which has to start
    /// and to be armed.
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
    /// Whether it flies, so that variants can leave it out.
    pub enabled: bool,
    /// What is done about a finding: `tell`, `failsafe` or `law`.
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
    /// Where the page is served: PORT, IP, IP:PORT; loopback without it.
    pub address: String,
}

/// `[recorder]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct RecorderSection {
    /// Whether the run keeps a log.
    pub enabled: bool,
    /// Size at which the log goes on in the next file.
    pub max_size: Option<Bytes>,
    /// Bench time after which the log goes on in the next file.
    pub max_duration: Option<Seconds>,
    /// So many files are kept, the last ones.
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
    /// Program and arguments that run instead of the built-in node, or as a node of a new name.
    pub exec: Option<Vec<String>>,
    /// Real hardware that takes the node's place.
    pub bridge: Option<BridgeKind>,
    /// More environment variables for `exec`.
    pub env: BTreeMap<String, String>,
    /// How the launcher learns that the node is ready.
    pub ready: Ready,
    /// The node runs elsewhere, started by hand with `whirlstand node`; the launcher does not start it.
    pub external: bool,
    /// Zenoh endpoints that this node listens on instead of those of `[zenoh]`.
    pub listen: Vec<String>,
    /// Zenoh endpoints that this node connects to, beside those of `[zenoh]`.
    pub connect: Vec<String>,
    /// What happens when the node dies.
    pub restart: Restart,
    /// How often it is restarted at most.
    pub max_restarts: u32,
    /// Longest time until it is ready.
    pub ready_timeout_s: Seconds,
    /// Longest silence of a node that publishes `Health`; then it is killed and counts as failed.
    pub hang_timeout_s: Seconds,
    /// Time between asking it to end (SIGTERM) and killing it (SIGKILL); see [`Self::stop_timeout_s`].
    pub stop_timeout_s: Option<Seconds>,
    /// Priority under SCHED_FIFO, 1 to 99.
    #[serde(deserialize_with = "priority")]
    pub priority: Option<u8>,
    /// CPUs that it may use; empty: all.
    pub cpus: Vec<usize>,
    /// Lock all memory.
    pub lock_memory: bool,
}

impl NodeSection {
    /// How often the node can be started in a run.
    pub fn starts(&self) -> u32 {
        match self.restart {
            Restart::Never => 1,
            Restart::OnFailure => self.max_restarts.saturating_add(1),
        }
    }

    /// Time between asking the node to end and killing it, s: 3 s unless stated, and half a minute for a recorder, which has
    /// to bring a log to a disk that may be busy. Killing it would lose what it holds.
    pub fn stop_timeout_s(&self, role: Option<Role>) -> f64 {
        let usual = if role == Some(Role::Recorder) { 30.0 } else { 3.0 };
        self.stop_timeout_s.map_or(usual, |stated| stated.0)
    }

    /// What the node asks of the operating system.
    pub fn realtime(&self) -> RealtimeOptions {
        RealtimeOptions { priority: self.priority, cpus: self.cpus.clone(), lock_memory: self.lock_memory }
    }
}

/// Any number, so that one out of range is refused in words.
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

/// How a node becomes ready.
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
    /// Endpoints that every node listens on, with port 0 so that each takes a free one; empty: on the loopback.
    pub listen: Vec<String>,
    /// Endpoints that every node connects to, beside the other nodes of the bench.
    pub connect: Vec<String>,
    /// Zenoh's own configuration file (JSON5), relative to the launch file.
    pub config: Option<String>,
}

/// `[security]`: who is let into a bench over Zenoh.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct SecuritySection {
    /// Without it: a secret, where that can protect the bench.
    pub mode: Option<SecurityMode>,
    /// Folder that `whirlstand keys new` has made, relative to the launch file.
    pub keys: Option<String>,
}

/// How a bench is protected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum SecurityMode {
    /// Not at all.
    Open,
    /// By keys that the launcher makes for one run, on one host.
    Secret,
    /// By keys that were made before, on several hosts.
    Tls,
}

/// `[[variants]]`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct VariantSection {
    /// Name of the run; also its folder.
    pub name: String,
    /// What differs: dotted keys and values, as with `--set`.
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
