//! A measured figure with its goal.

use serde::Serialize;

/// A measured figure.
#[derive(Debug, Clone, Serialize)]
pub struct Figure {
    /// Name of the measurement, for example `lockstep over iceoryx2, three processes`.
    pub name: String,
    /// Median of all repetitions.
    pub value: f64,
    /// Unit of the values.
    pub unit: &'static str,
    /// Values of all repetitions.
    pub all: Vec<f64>,
    /// Goal of the project; absent where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub goal: Option<Goal>,
}

/// Goal for a figure.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Goal {
    /// The limit, in the figure's unit.
    pub limit: f64,
    /// True when the figure must be at least the limit; otherwise at most.
    pub at_least: bool,
    /// True when the goal is met.
    pub met: bool,
}

impl Figure {
    /// A figure for which more is better.
    pub(super) fn highest(
        name: impl Into<String>,
        unit: &'static str,
        all: Vec<f64>,
        goal: Option<f64>,
    ) -> Self {
        let value = median(&all);
        let goal = goal.map(|limit| Goal { limit, at_least: true, met: value >= limit });
        Self { name: name.into(), value, unit, all, goal }
    }

    /// A figure for which less is better.
    pub(super) fn lowest(
        name: impl Into<String>,
        unit: &'static str,
        all: Vec<f64>,
        goal: Option<f64>,
    ) -> Self {
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
