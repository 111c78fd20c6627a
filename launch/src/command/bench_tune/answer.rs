//! What comes of a cell.

use serde::{Deserialize, Serialize};

use crate::tune::LawFigures;

/// What came of a cell, a line of `cells.jsonl`.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Cell {
    /// Vehicle, law and effect.
    pub cell: String,
    /// Who keeps the time of flights over processes; absent for flights in one thread.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub processes: Option<String>,
    /// What was flown.
    pub result: Answer,
    /// Time that it took, s.
    pub wall_s: f64,
}

/// What a cell came to.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Answer {
    /// It was flown to its end.
    Flown(Box<Outcome>),
    /// Why it was not.
    Failed(String),
}

/// What three laws cost on the truth.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Outcome {
    /// What the diagnosis named.
    pub named: Vec<String>,
    /// The new law is kept.
    pub kept: bool,
    /// The old law.
    pub before: OnTruth,
    /// The law of `tuned.toml`.
    pub after: OnTruth,
    /// The new law, kept or not.
    pub new: OnTruth,
    /// The law that was designed on the truth.
    pub designed: OnTruth,
    /// (before - after) / (before - designed), of the median costs.
    pub share: Option<f64>,
    /// Lower end of the interval of after over before.
    pub after_over_before_low: Option<f64>,
    /// Upper end of the interval of designed over before.
    pub designed_over_before_high: Option<f64>,
}

/// A law on the truth.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) struct OnTruth {
    /// Median cost; absent when the vehicle was lost on all seeds.
    pub cost: Option<f64>,
    /// Share of the seeds on which it was lost.
    pub lost: f64,
}

impl OnTruth {
    /// What its flights came to.
    pub fn of(figures: &LawFigures) -> Self {
        Self { cost: figures.cost.map(|c| c.median), lost: figures.probability_unstable.share }
    }
}
