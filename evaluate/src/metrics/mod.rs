//! Control figures of a run: step responses, recovery from disturbances, effort, consistency of the estimator,
//! timing. See `docs/metrics.md`.

mod charge;
mod disturbance;
mod effort;
mod estimator;
mod events;
mod judge;
mod step;
mod timing;
mod window;

pub use charge::ChargeSteps;
pub use disturbance::{Recovery, recovery};
pub use effort::Effort;
pub(crate) use effort::EffortSum;
pub(crate) use estimator::{Claim, ConsistencySum};
pub use estimator::{Consistency, StateError, nis_bounds};
pub use events::DisturbanceEvent;
pub(crate) use events::{Changes, Onsets, SetpointSteps};
pub(crate) use judge::{Judge, Judgement, Part, Samples};
pub use step::{StepResponse, step_response};
pub(crate) use timing::{FailsafeSteps, timing};
pub use timing::{Latency, NodeTiming, Timing, latency, total};

/// Integral of `f(y)` over `t` by the trapezium rule.
pub fn integral(t: &[f64], y: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    t.windows(2).zip(y.windows(2)).map(|(t, y)| 0.5 * (t[1] - t[0]) * (f(y[0]) + f(y[1]))).sum()
}
