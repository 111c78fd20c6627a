//! Measuring bodies of `whirlstand bench`: throughput, latency and jitter, each beside the bare floor of the same
//! machine in the same run.
//!
//! Every process of a measurement is this same executable, started again with [`Options::member`] and a
//! [`Member`] as JSON on standard input; [`run_member`] is what it then does.

mod autopilot;
mod bridge;
mod cyclictest;
mod fleet;
mod member;
mod realtime;
mod round_trips;
mod throughput;

use std::collections::BTreeMap;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use whirlstand_bus::Transport;
use whirlstand_vehicle::Vehicle;

use crate::config::{
    ControllerConfig, EstimatorConfig, LawKind, Mode, NodeConfig, PlantConfig, Role, VehicleSource,
};
pub use member::{Member, run_member};

/// The measurements, in the order in which they run.
pub const MEASUREMENTS: [&str; 8] =
    ["plant", "inproc", "lockstep", "recorded", "zenoh", "realtime", "vehicles", "autopilots"];

/// What to measure, and how.
#[derive(Debug, Clone)]
pub struct Options {
    /// Names from [`MEASUREMENTS`]; empty: all.
    pub what: Vec<String>,
    /// Length of each throughput measurement, s.
    pub seconds: f64,
    /// How often each throughput is measured; the median counts, and all are reported.
    pub repeat: u32,
    /// Length of the real-time measurement, s.
    pub realtime_seconds: f64,
    /// SCHED_FIFO priority of the real-time measurement; `None` for an ordinary one.
    pub priority: Option<u8>,
    /// CPUs on which plant, estimator and controller run in the lockstep measurement, and the positions of the ring
    /// beside it alike; empty: the scheduler decides.
    pub cpus: Vec<usize>,
    /// Program and arguments that start a [`Member`].
    pub member: Vec<String>,
}

/// One figure.
#[derive(Debug, Clone, Serialize)]
pub struct Figure {
    /// What was measured, for example `lockstep over iceoryx2, three processes`.
    pub name: String,
    /// The median of all repetitions.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// All repetitions.
    pub all: Vec<f64>,
    /// What the project promises; absent where it promises nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
}

/// A promise about a figure.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Goal {
    /// The limit, in the figure's unit.
    pub limit: f64,
    /// Whether the figure must be at least the limit; otherwise at most.
    pub at_least: bool,
    /// Whether it is.
    pub met: bool,
}

/// All figures of a call.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// `whirlstand.bench.v1`.
    pub schema: &'static str,
    /// CPUs that this process may use.
    pub cpus: usize,
    /// Kernel, as `/proc/version` says.
    pub kernel: String,
    /// The figures.
    pub figures: Vec<Figure>,
}

/// Why a measurement failed.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// There is no such measurement.
    #[error("there is no measurement \"{0}\"; there are {list}", list = MEASUREMENTS.join(", "))]
    Unknown(String),
    /// A process cannot be started or talked to.
    #[error("{what}: {source}")]
    Process {
        /// What was tried.
        what: String,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A process ended badly or said something unexpected.
    #[error("{who} failed: {why}")]
    Member {
        /// Which process.
        who: String,
        /// Its last words.
        why: String,
    },
    /// A node in this process failed.
    #[error(transparent)]
    Node(#[from] crate::NodeError),
    /// A ring failed.
    #[error(transparent)]
    Ring(#[from] whirlstand_bus::ring::RingError),
}

/// Runs the measurements; `progress` hears each figure as it comes.
///
/// # Errors
/// [`BenchError`] for the first measurement that cannot run.
pub fn run(options: &Options, mut progress: impl FnMut(&Figure)) -> Result<Report, BenchError> {
    if let Some(unknown) = options.what.iter().find(|w| !MEASUREMENTS.contains(&w.as_str())) {
        return Err(BenchError::Unknown(unknown.clone()));
    }
    let mut figures = Vec::new();
    for name in MEASUREMENTS {
        if !options.what.is_empty() && !options.what.iter().any(|w| w == name) {
            continue;
        }
        let new = match name {
            "plant" => throughput::plant(options)?,
            "inproc" => throughput::inproc(options)?,
            "lockstep" => throughput::lockstep(options)?,
            "recorded" => throughput::recorded(options)?,
            "zenoh" => throughput::zenoh(options)?,
            "realtime" => realtime::realtime(options)?,
            "vehicles" => bridge::bridges(options)?,
            _ => autopilot::autopilots(options)?,
        };
        new.iter().for_each(&mut progress);
        figures.extend(new);
    }
    Ok(Report {
        schema: "whirlstand.bench.v1",
        cpus: std::thread::available_parallelism().map_or(1, usize::from),
        kernel: std::fs::read_to_string("/proc/version").unwrap_or_default().trim().into(),
        figures,
    })
}

impl Figure {
    /// A figure of which more is better.
    fn highest(name: impl Into<String>, unit: &'static str, all: Vec<f64>, goal: Option<f64>) -> Self {
        let value = median(&all);
        let goal = goal.map(|limit| Goal { limit, at_least: true, met: value >= limit });
        Self { name: name.into(), value, unit, all, goal }
    }

    /// A figure of which less is better.
    fn lowest(name: impl Into<String>, unit: &'static str, all: Vec<f64>, goal: Option<f64>) -> Self {
        let value = median(&all);
        let goal = goal.map(|limit| Goal { limit, at_least: false, met: value <= limit });
        Self { name: name.into(), value, unit, all, goal }
    }
}

/// The middle one, or the mean of the two in the middle.
fn median(all: &[f64]) -> f64 {
    let mut sorted = all.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (low, high) = (sorted.len().saturating_sub(1) / 2, sorted.len() / 2);
    match (sorted.get(low), sorted.get(high)) {
        (Some(a), Some(b)) => (a + b) / 2.0,
        _ => f64::NAN,
    }
}

/// The bench that is measured: the quadrotor with its noisy sensors, model-based estimator, LQR, no log.
fn config(name: &str, transport: Transport, mode: Mode, steps: u64) -> Result<NodeConfig, BenchError> {
    let vehicle = Vehicle::builtin("quadrotor")
        .map_err(|e| BenchError::Member { who: "the built-in quadrotor".into(), why: e.to_string() })?;
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().subsec_micros();
    Ok(NodeConfig {
        bench: format!("bench-{name}-{}-{now}", std::process::id()),
        transport,
        zenoh: whirlstand_bus::ZenohConfig::default(),
        vehicle: VehicleSource { origin: "quadrotor".into(), text: vehicle.source_text },
        effects: Vec::new(),
        mode,
        period_ns: 1_000_000,
        steps,
        seed: 1,
        peers: vec![Role::Estimator, Role::Controller],
        start_timeout_s: 20.0,
        telemetry: false,
        plant: PlantConfig { lockstep_timeout_s: 2.0, ..PlantConfig::default() },
        estimator: EstimatorConfig::default(),
        controller: ControllerConfig::new(LawKind::Lqr),
        recorder: None,
        setpoint: Vec::new(),
        stick: Vec::new(),
        realtime: BTreeMap::new(),
        bridge: None,
    })
}
