//! What a search came to: the accepted causes with their fit, and what of them is kept.

use crate::candidates::library::Candidate;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::ModelError;
use crate::search::acceptance::{Rival, TermEvidence};
use crate::search::alternative::Alternative;
use crate::thresholds::RIDER_SHARE;
use whirlstand_vehicle::Kind;

/// An accepted term.
#[derive(Debug, Clone, PartialEq)]
pub struct Accepted {
    /// Evidence.
    pub evidence: TermEvidence,
    /// Rivals, nearest first.
    pub rivals: Vec<Rival>,
}

/// A candidate that was not accepted. Of its fit only the values are kept: all of it would be as large as the record, several
/// times for each candidate.
#[derive(Debug, Clone)]
pub struct Refused {
    /// The candidate.
    pub candidate: Candidate,
    /// The values of the model with it, its own last; `None` when it was not worth a fit.
    pub values: Option<Vec<f64>>,
    /// The model's terms beside it.
    pub beside: Vec<Candidate>,
    /// Gain in BIC over the model without it: by the fit, or estimated from the score.
    pub delta_bic: f64,
    /// Why it was not accepted.
    pub why: String,
}

impl Refused {
    /// An alternative that is not accepted, and why.
    pub fn new(Alternative { candidate, fit, beside, delta_bic, .. }: Alternative, why: String) -> Self {
        Self { candidate, values: fit.map(|fit| fit.values), beside, delta_bic, why }
    }
}

/// What the search came to.
#[derive(Debug, Clone)]
pub struct Selection<'r, 'd> {
    /// The model with all accepted terms.
    pub model: Model<'r, 'd>,
    /// Its fit.
    pub fit: Fit,
    /// The fit without any term.
    pub null: Fit,
    /// Evidence of each term.
    pub accepted: Vec<Accepted>,
    /// Candidates beside the accepted ones that were not accepted; nearest first.
    pub refused: Vec<Refused>,
}

impl<'r, 'd> Selection<'r, 'd> {
    /// A selection that has not looked for anything.
    ///
    /// # Errors
    /// When the vehicle cannot be simulated over the record.
    pub fn nothing(model: Model<'r, 'd>, start: Vec<f64>) -> Result<Self, ModelError> {
        let null = model.fit(start, None, None)?;
        Ok(Self { model, fit: null.clone(), null, accepted: Vec::new(), refused: Vec::new() })
    }
}

impl Selection<'_, '_> {
    /// The selection without its causes, fitted anew; `None` when there are none. A tone is believed whatever else there is.
    /// `start` are the values without any cause.
    pub fn without_causes(&self, start: Vec<f64>) -> Option<Self> {
        let tone = |c: &Candidate| c.kind == Kind::Vibration;
        self.model.terms.iter().any(|c| !tone(c)).then_some(())?;
        let mut kept = self.clone();
        kept.keep(tone);
        kept.fit.values.splice(..start.len(), start);
        kept.fit = kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None).ok()?;
        Some(kept)
    }

    /// The selection without causes of which what is `left` is more than a misfit, fitted anew; `None` when there are none.
    pub fn beyond(&self, left: f64) -> Option<Self> {
        let enough = |a: &Accepted| RIDER_SHARE * a.evidence.detectability >= left;
        (!self.accepted.iter().all(enough)).then_some(())?;
        let mut kept = self.clone();
        let wanted: Vec<bool> = self.accepted.iter().map(enough).collect();
        kept.keep_terms(|term, _, _| wanted[term]);
        kept.fit = kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None).ok()?;
        Some(kept)
    }

    /// Drops the terms that are not wanted, with their values and their evidence; the fit is not made anew.
    pub fn keep(&mut self, wanted: impl Fn(&Candidate) -> bool) {
        self.keep_terms(|_, candidate, _| wanted(candidate));
    }

    /// As [`Selection::keep`], by the number and the values too.
    pub fn keep_terms(&mut self, wanted: impl Fn(usize, &Candidate, &[f64]) -> bool) {
        for term in (0..self.model.terms.len()).rev() {
            let range = self.model.range(term);
            if !wanted(term, &self.model.terms[term], &self.fit.values[range.clone()]) {
                self.fit.values.drain(range);
                self.model.terms.remove(term);
                self.accepted.remove(term);
            }
        }
    }
}
