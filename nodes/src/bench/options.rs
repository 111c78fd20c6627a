//! What can be measured, and how.

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
    /// Program and arguments that fly a launch file: `whirlstand run`.
    pub run: Vec<String>,
}
