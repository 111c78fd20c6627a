//! An answer with the likelihood by which answers are compared.

use super::findings::Findings;
use crate::answer::schema::OutputGain;
use crate::answer::{Diagnosis, compose};
use crate::model::predictor::Likelihood;
use crate::thresholds::LOUD_RATIO;

/// An answer and the likelihood by which it is chosen.
#[derive(Debug, Clone)]
pub(crate) struct Weighed {
    pub answer: Diagnosis,
    /// Likelihood of the record with everything that was found; `None` without a prediction.
    pub likelihood: Option<Likelihood>,
    /// True when the causes are likelier with inputs that were at rest before the records.
    pub rest_before: bool,
    /// True when the data themselves are wrong, so that no predictor helps.
    pub blocked: bool,
    /// True when half or more of the outputs on the held-out part are predicted better than by their means,
    /// or as well as their declared noise allows.
    pub means_something: bool,
}

impl Weighed {
    pub fn new(findings: Findings<'_>) -> Self {
        let selection = &findings.residual.selection;
        let profile = &selection.fit.profile;
        let turbulence = if findings.residual.turbulence.is_some() { 2 } else { 0 };
        let memory = usize::from(findings.baseline.data().memory_s.is_some());
        let bic = profile.bic(selection.model.parameters() + turbulence + memory);
        let (rows, blocked) = (profile.rows, findings.baseline.blocked);
        let rest_before = findings.residual.rest_before;
        let answer = compose::answer(findings);
        let poor = answer.outputs.values().filter(|o| is_poor(o)).count();
        let means_something = 2 * poor <= answer.outputs.len();
        Self { answer, likelihood: Some(Likelihood { bic, rows }), rest_before, blocked, means_something }
    }

    /// An answer without a prediction, which has no likelihood.
    pub fn nothing(answer: Diagnosis) -> Self {
        let blocked = answer.data.iter().any(|f| f.blocking);
        Self { answer, likelihood: None, rest_before: false, blocked, means_something: false }
    }
}

/// True when an output is predicted no better than by its mean, though its declared noise would allow a
/// better prediction.
fn is_poor(o: &OutputGain) -> bool {
    let lost = o.rmse_after.is_none() && o.horizon_fit_after.is_some();
    let undeclared = o.noise_model_share.is_some();
    let loud = o.rmse_after.is_some_and(|rmse| rmse > LOUD_RATIO * o.noise_floor);
    lost || o.fit_after.is_some_and(|fit| fit <= 0.0) && (undeclared || loud)
}
