//! The result of one cell of the measurement.

use serde::{Deserialize, Serialize};

use crate::tune::LawFigures;

/// The result of a cell, which is a line of `cells.jsonl`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Cell {
    /// Vehicle, law and effect.
    pub cell: String,
    /// Mode of the clock for flights over processes; absent for flights in one thread.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub processes: Option<String>,
    /// The result of the flights.
    pub result: Answer,
    /// Wall-clock time of the cell, s.
    pub wall_s: f64,
}

/// Outcome or failure of a cell.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Answer {
    /// The cell was flown to its end.
    Flown(Box<Outcome>),
    /// The reason why the cell was not flown to its end.
    Failed(String),
}

/// Costs of the laws on the true vehicle.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Outcome {
    /// Causes that the diagnosis named.
    pub named: Vec<String>,
    /// Whether the new law is kept.
    pub kept: bool,
    /// Result of the old law.
    pub before: OnTruth,
    /// Result of the law in `tuned.toml`.
    pub after: OnTruth,
    /// Result of the new law, kept or not.
    pub new: OnTruth,
    /// Result of the law designed on the true vehicle.
    pub designed: OnTruth,
    /// Share of the possible gain: (before - after) / (before - designed), median costs.
    pub share: Option<f64>,
    /// Lower end of the confidence interval of the cost ratio after / before.
    pub after_over_before_low: Option<f64>,
    /// Upper end of the confidence interval of the cost ratio designed / before.
    pub designed_over_before_high: Option<f64>,
}

/// Result of a law on the true vehicle.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct OnTruth {
    /// Median cost; absent when the vehicle was lost on all seeds.
    pub cost: Option<f64>,
    /// Share of the seeds on which the vehicle was lost.
    pub lost: f64,
}

impl OnTruth {
    /// Extracts the result from the figures of the flights of one law.
    pub fn of(figures: &LawFigures) -> Self {
        Self { cost: figures.cost.map(|c| c.median), lost: figures.probability_unstable.share }
    }
}
