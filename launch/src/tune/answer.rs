//! What `whirlstand tune` answers.

use std::collections::BTreeMap;

use serde::Serialize;
use whirlstand_control::design::{LeftOut, LoopFigures};
use whirlstand_diagnose::answer::Cause;
use whirlstand_nodes::config::LawKind;

use super::judge::{Gain, LawFigures};
use super::retune::Retuned;
use super::truth::OnTruth;

/// What `whirlstand tune` answers.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Tuning {
    /// `whirlstand.tune.v1`.
    pub schema: &'static str,
    /// The launch file.
    pub launch: String,
    /// The vehicle that the old law was designed for.
    pub vehicle: String,
    /// The old law and the new one.
    pub law_before: LawKind,
    /// See [`Self::law_before`].
    pub law_after: LawKind,
    /// The verdict of the diagnosis, in a sentence.
    pub diagnosis: String,
    /// What it found.
    pub causes: Vec<Cause>,
    /// What the new law cannot use.
    pub left_out: Vec<LeftOut>,
    /// Number of draws that both laws flew.
    pub draws: u64,
    /// The old law on the extended vehicle.
    pub before: LawFigures,
    /// The new law on it.
    pub after: LawFigures,
    /// Margins of the old law with its filter around the extended vehicle; absent for the stick.
    pub loop_before: Option<LoopFigures>,
    /// Margins of the new one.
    pub loop_after: Option<LoopFigures>,
    /// Which is better.
    pub gain: Gain,
    /// Weights that were chosen anew, and on what.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retuned: Option<Retuned>,
    /// The draw on which the law that is kept costs most.
    pub worst: WorstDraw,
    /// What the laws are worth on the vehicle that was told to be the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<OnTruth>,
    /// The launch file that `run` takes.
    pub tuned: String,
    /// The extended vehicle file, if something was found.
    pub extended_vehicle: Option<String>,
    /// The page.
    pub report: String,
}

/// The draw on which a law costs most.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct WorstDraw {
    /// Its number.
    pub draw: u64,
    /// The vehicle was lost.
    pub lost: bool,
    /// Its figures under the keys of `[expect]`, SI.
    pub figures: BTreeMap<String, f64>,
    /// The launch file that flies it.
    pub launch: String,
}
