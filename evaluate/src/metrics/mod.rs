//! Control figures of a run: step responses, recovery from disturbances, effort, consistency of the estimator,
//! timing. See `docs/metrics.md`.

mod disturbance;
mod effort;
mod estimator;
mod events;
mod step;
mod timing;
mod window;

pub use disturbance::{Recovery, recovery};
pub use effort::{Effort, effort};
pub use estimator::{Consistency, StateError, consistency, nis_bounds};
pub use events::{DisturbanceEvent, disturbance_events, setpoint_steps};
pub use step::{StepResponse, step_response};
pub use timing::{Latency, NodeTiming, Timing, latency, timing, total};

/// Integral of `f(y)` over `t` by the trapezium rule.
pub fn integral(t: &[f64], y: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    t.windows(2).zip(y.windows(2)).map(|(t, y)| 0.5 * (t[1] - t[0]) * (f(y[0]) + f(y[1]))).sum()
}
