//! Control figures of a run: step responses, recovery from disturbances, effort. See `docs/metrics.md`.

mod disturbance;
mod effort;
mod step;
pub(crate) mod window;

pub use disturbance::{Recovery, recovery};
pub use effort::{Effort, effort};
pub use step::{StepResponse, step_response};

/// Integral of `f(y)` over `t` by the trapezium rule.
pub fn integral(t: &[f64], y: &[f64], f: impl Fn(f64) -> f64) -> f64 {
    t.windows(2).zip(y.windows(2)).map(|(t, y)| 0.5 * (t[1] - t[0]) * (f(y[0]) + f(y[1]))).sum()
}
