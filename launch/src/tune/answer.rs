//! The answer of `whirlstand tune`.

use std::collections::BTreeMap;

use serde::Serialize;
use whirlstand_control::design::{LeftOut, LoopFigures};
use whirlstand_diagnose::answer::Cause;
use whirlstand_nodes::config::LawKind;

use super::judge::{Gain, LawFigures};
use super::retune::Retuned;
use super::truth::OnTruth;

/// The answer of `whirlstand tune`.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Tuning {
    /// `whirlstand.tune.v1`.
    pub schema: &'static str,
    /// Name of the launch file.
    pub launch: String,
    /// Name of the vehicle for which the old law was designed.
    pub vehicle: String,
    /// The old law and the new one.
    pub law_before: LawKind,
    /// See [`Self::law_before`].
    pub law_after: LawKind,
    /// The verdict of the diagnosis, in a sentence.
    pub diagnosis: String,
    /// Causes that the diagnosis found.
    pub causes: Vec<Cause>,
    /// Effects that the design of the new law cannot use.
    pub left_out: Vec<LeftOut>,
    /// Number of draws flown with each law.
    pub draws: u64,
    /// Figures of the old law on the extended vehicle.
    pub before: LawFigures,
    /// Figures of the new law on the extended vehicle.
    pub after: LawFigures,
    /// Margins of the old law with its filter around the extended vehicle; absent for control by stick.
    pub loop_before: Option<LoopFigures>,
    /// Margins of the new law with its filter around the extended vehicle.
    pub loop_after: Option<LoopFigures>,
    /// Comparison of the two laws.
    pub gain: Gain,
    /// Weights that were chosen anew, and the draws that they were chosen on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub retuned: Option<Retuned>,
    /// The draw on which the kept law costs most.
    pub worst: WorstDraw,
    /// Results of the laws on the vehicle that was given as the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub truth: Option<OnTruth>,
    /// The launch file that `run` takes.
    pub tuned: String,
    /// The extended vehicle file, if the diagnosis found a cause.
    pub extended_vehicle: Option<String>,
    /// The report page.
    pub report: String,
}

/// The draw on which a law costs most.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct WorstDraw {
    /// Number of the draw.
    pub draw: u64,
    /// Whether the vehicle was lost.
    pub lost: bool,
    /// Figures of the draw under the keys of `[expect]`, SI.
    pub figures: BTreeMap<String, f64>,
    /// The launch file that flies the draw.
    pub launch: String,
}
