//! Configuration of the nodes: one [`NodeConfig`] for all nodes of a bench, as JSON.
//!
//! The launcher derives it from a launch file and passes the same text to every child; a node started by hand
//! on another host reads it from a file. All numbers are SI. Unknown keys are refused.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
pub use whirlstand_bridge::config::BridgeConfig;
use whirlstand_bus::{Transport, ZenohConfig};
pub use whirlstand_control::Compensation;
use whirlstand_control::{AntiWindup, LawOptions, LqrOptions, PpcOptions, Selector, SmcOptions, Weights};
pub use whirlstand_control::{EstimatorKind, EstimatorOptions as EstimatorConfig};
use whirlstand_vehicle::Effect;

pub use crate::mirror_config::{MirrorConfig, OnFinding};

/// Configuration of a bench, for all its nodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeConfig {
    /// Name of the bench, which prefixes its topics.
    pub bench: String,
    /// Transport of the messages.
    #[serde(default = "iceoryx2")]
    pub transport: Transport,
    /// Endpoints and options of Zenoh; unused by the other transports.
    #[serde(default)]
    pub zenoh: ZenohConfig,
    /// Text of the vehicle file.
    pub vehicle: VehicleSource,
    /// Text of the vehicle file for the design of law and filter; absent: that of the vehicle. It has the
    /// same signals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<VehicleSource>,
    /// Effects of the launch file, appended to the vehicle's own. Only the plant knows them, and the sensors of
    /// an autopilot before the run.
    #[serde(default)]
    pub effects: Vec<Effect>,
    /// Pace of the loop.
    pub mode: Mode,
    /// Period of the loop, ns of bench time.
    pub period_ns: u64,
    /// Number of steps of the run: steps 0 to `steps - 1`.
    pub steps: u64,
    /// Seed of every random stream.
    pub seed: u64,
    /// Native nodes whose `Health` must be received before step 0, by role (`estimator`, `controller`,
    /// `recorder`). A node run by a foreign program is left out: the plant then repeats step 0 until it is
    /// answered.
    #[serde(default = "native_peers")]
    pub peers: Vec<Role>,
    /// Longest wait of the plant for its peers and for the answer to step 0, s of wall-clock time.
    #[serde(default = "start_timeout")]
    pub start_timeout_s: f64,
    /// Publish `Truth`, `Setpoint` and `Disturbance`, which the recorder needs; a run without them is faster.
    #[serde(default = "yes")]
    pub telemetry: bool,
    /// Plant options.
    #[serde(default)]
    pub plant: PlantConfig,
    /// Estimator options.
    #[serde(default)]
    pub estimator: EstimatorConfig,
    /// Controller options.
    pub controller: ControllerConfig,
    /// Recorder options; absent: the run keeps no log.
    #[serde(default)]
    pub recorder: Option<RecorderConfig>,
    /// Options of the mirror; absent: the flight is not monitored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirror: Option<MirrorConfig>,
    /// Steps of the reference, in time order.
    #[serde(default)]
    pub setpoint: Vec<SignalChange>,
    /// Steps of the stick, in time order, by input name; flown by the law `manual`, and by the others under `add_stick`.
    #[serde(default)]
    pub stick: Vec<SignalChange>,
    /// Operating-system options by role; a role left out runs as an ordinary process.
    #[serde(default)]
    pub realtime: BTreeMap<Role, RealtimeOptions>,
    /// Bridge to real hardware that replaces a node.
    #[serde(default)]
    pub bridge: Option<BridgeConfig>,
}

/// Text and origin of a vehicle file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleSource {
    /// File name or built-in name, for error messages.
    pub origin: String,
    /// The file's text.
    pub text: String,
}

/// Pace of the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The plant wakes at absolute deadlines; a late command is a deadline miss.
    Realtime,
    /// The plant waits for each command; the loop runs as fast as the processes can.
    Lockstep,
}

/// Role of a node in the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Simulates the vehicle and sets the pace.
    Plant,
    /// Estimates the states from measurements.
    Estimator,
    /// Computes commands from estimated states.
    Controller,
    /// Writes the log.
    Recorder,
    /// Compares the flight with the vehicle file, outside the loop.
    Mirror,
}

/// Options of the plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantConfig {
    /// State of the engine, which sets the amplitude of the vibration.
    pub engine: Engine,
    /// Initial states by name, SI; the others are zero.
    pub initial: BTreeMap<String, f64>,
    /// Consecutive deadline misses after which a realtime plant goes to its failsafe.
    pub misses_to_failsafe: u32,
    /// Longest wait of a lockstep plant for a command, s of wall-clock time. Absent: it waits as long as the
    /// responsible nodes are alive, and the run does not depend on any clock.
    pub answer_timeout_s: Option<f64>,
    /// Accept disturbances from outside on topic `inject`.
    pub inject: bool,
}

/// State of the engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Engine {
    /// Engine off.
    Off,
    /// Engine running on the ground.
    On,
    /// Engine running in flight.
    Flying,
}

/// Options of the controller. Options of other laws than `law` are allowed and ignored, so that variants of a
/// launch file can change the law alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerConfig {
    /// Kind of the law.
    pub law: LawKind,
    /// LQR: diagonal of Q; SMC: diagonal of the weight that shapes the surface.
    #[serde(default)]
    pub q: Option<Weights>,
    /// LQR: diagonal of R.
    #[serde(default)]
    pub r: Option<Weights>,
    /// PPC: closed-loop poles; SMC: poles on the surface. Continuous time, `[real, imaginary]`, 1/s.
    #[serde(default)]
    pub poles: Option<Vec<[f64; 2]>>,
    /// PPC: smallest natural frequency of the default poles, rad/s.
    #[serde(default)]
    pub bandwidth: Option<f64>,
    /// PPC: smallest damping ratio of the default poles.
    #[serde(default)]
    pub damping: Option<f64>,
    /// SMC: exponential part of the reaching law, 1/s.
    #[serde(default)]
    pub reaching_rate: Option<f64>,
    /// SMC: switching gain of each surface, in units of the inputs.
    #[serde(default)]
    pub switching_gain: Option<Weights>,
    /// SMC: half-width of the boundary layer, in input units times s.
    #[serde(default)]
    pub boundary_layer: Option<Weights>,
    /// SMC: super-twisting in place of the constant-plus-proportional reaching law.
    #[serde(default)]
    pub super_twisting: bool,
    /// States whose error is integrated.
    #[serde(default)]
    pub integral: Vec<Selector>,
    /// LQR: weight of each integral.
    #[serde(default)]
    pub integral_q: Option<Vec<f64>>,
    /// Behaviour of integrators at the input limits.
    #[serde(default)]
    pub anti_windup: AntiWindup,
    /// Add the stick to the command of the law, within its limits: a test input in closed loop.
    #[serde(default)]
    pub add_stick: bool,
    /// Nonlinear effects of the vehicle that the law compensates.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub compensate: Vec<Compensation>,
    /// Accept setpoints from outside on topic `pilot`; the newest one replaces the profile.
    #[serde(default)]
    pub pilot: bool,
}

/// The control laws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LawKind {
    /// Linear-quadratic regulator.
    Lqr,
    /// Pole placement control.
    Ppc,
    /// Sliding-mode control.
    Smc,
    /// Open loop: the stick passes through.
    Manual,
}

/// Options of the recorder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecorderConfig {
    /// Path of the log, for example `out/log.mcap`; a restarted recorder writes `out/log.2.mcap`, and so on.
    pub path: String,
    /// Largest number of runs recorded by one recorder: one for each start of the plant.
    #[serde(default = "most_runs")]
    pub most_runs: u32,
    /// Size at which the next file begins, bytes; absent: no limit.
    #[serde(default)]
    pub max_bytes: Option<u64>,
    /// Bench time after which the next file begins, ns; absent: no limit.
    #[serde(default)]
    pub max_duration_ns: Option<u64>,
    /// Number of files kept, the last ones; absent: all.
    #[serde(default)]
    pub segments: Option<u32>,
    /// Text of the launch file, stored in the log.
    #[serde(default)]
    pub launch_text: String,
    /// Version of the program, stored in the log.
    #[serde(default)]
    pub version: String,
}

/// New values of named signals at a time; other signals keep their values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalChange {
    /// Bench time, s.
    pub at_s: f64,
    /// Values by signal name, SI.
    pub values: BTreeMap<String, f64>,
}

/// Operating-system options of a node.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeOptions {
    /// Priority under `SCHED_FIFO`, 1 to 99.
    pub priority: Option<u8>,
    /// CPUs that the node may run on; empty: all.
    pub cpus: Vec<usize>,
    /// Lock all memory (`mlockall`), so that no page fault can delay a step.
    pub lock_memory: bool,
}

impl Default for PlantConfig {
    fn default() -> Self {
        Self {
            engine: Engine::Flying,
            initial: BTreeMap::new(),
            misses_to_failsafe: 5,
            answer_timeout_s: None,
            inject: false,
        }
    }
}

impl ControllerConfig {
    /// A law with its default options.
    pub fn new(law: LawKind) -> Self {
        Self {
            law,
            q: None,
            r: None,
            poles: None,
            bandwidth: None,
            damping: None,
            reaching_rate: None,
            switching_gain: None,
            boundary_layer: None,
            super_twisting: false,
            integral: Vec::new(),
            integral_q: None,
            anti_windup: AntiWindup::default(),
            add_stick: false,
            compensate: Vec::new(),
            pilot: false,
        }
    }

    /// Options of the law itself; `None` for `manual`, which has none.
    pub fn options(&self) -> Option<LawOptions> {
        let (integral, anti_windup) = (self.integral.clone(), self.anti_windup);
        Some(match self.law {
            LawKind::Manual => return None,
            LawKind::Lqr => LawOptions::Lqr(LqrOptions {
                q: self.q.clone(),
                r: self.r.clone(),
                integral,
                integral_q: self.integral_q.clone(),
                anti_windup,
            }),
            LawKind::Ppc => LawOptions::Ppc(PpcOptions {
                poles: self.poles.clone(),
                bandwidth: self.bandwidth,
                damping: self.damping,
                integral,
                anti_windup,
            }),
            LawKind::Smc => LawOptions::Smc(SmcOptions {
                q: self.q.clone(),
                poles: self.poles.clone(),
                reaching_rate: self.reaching_rate,
                switching_gain: self.switching_gain.clone(),
                boundary_layer: self.boundary_layer.clone(),
                super_twisting: self.super_twisting,
                integral,
                anti_windup,
            }),
        })
    }
}

impl Role {
    /// Every role, in the order in which a step passes them.
    pub const ALL: [Self; 5] = [Self::Plant, Self::Estimator, Self::Controller, Self::Recorder, Self::Mirror];

    /// Name of the role on the command line, in launch files and in `Health`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Estimator => "estimator",
            Self::Controller => "controller",
            Self::Recorder => "recorder",
            Self::Mirror => "mirror",
        }
    }
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

fn iceoryx2() -> Transport {
    Transport::Iceoryx2
}

fn native_peers() -> Vec<Role> {
    vec![Role::Estimator, Role::Controller]
}

/// Default number of runs: the plant's first start, and the default number of restarts in a launch file.
fn most_runs() -> u32 {
    4
}

fn start_timeout() -> f64 {
    10.0
}

fn yes() -> bool {
    true
}

impl From<Engine> for whirlstand_vehicle::Engine {
    fn from(engine: Engine) -> Self {
        match engine {
            Engine::Off => Self::Off,
            Engine::On => Self::On,
            Engine::Flying => Self::Flying,
        }
    }
}
