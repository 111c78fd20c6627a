//! Options of the measurements.

/// The measurements, in the order in which they run.
pub const MEASUREMENTS: [&str; 10] = [
    "plant",
    "inproc",
    "flight",
    "lockstep",
    "recorded",
    "zenoh",
    "realtime",
    "transports",
    "vehicles",
    "autopilots",
];

/// Options of the measurements.
#[derive(Debug, Clone)]
pub struct Options {
    /// Names from [`MEASUREMENTS`]; empty: all.
    pub what: Vec<String>,
    /// Length of each throughput measurement, s.
    pub seconds: f64,
    /// Number of repetitions of each throughput measurement; the median counts, and all are reported.
    pub repeat: u32,
    /// Length of each flight of the real-time measurement, s.
    pub realtime_seconds: f64,
    /// SCHED_FIFO priority of the real-time measurement; `None` for ordinary scheduling.
    pub priority: Option<u8>,
    /// CPUs of plant, estimator and controller in the lockstep measurement and in a realtime one with a priority,
    /// and of the ring's positions in its reference; empty: the scheduler decides, with a priority the last CPU.
    pub cpus: Vec<usize>,
    /// Program and arguments that start a `Member`.
    pub member: Vec<String>,
    /// Program and arguments that run a launch file: `whirlstand run`.
    pub run: Vec<String>,
}
