//! Result of a search: the accepted causes with their fit, and the refused candidates.

use crate::candidates::library::Candidate;
use crate::model::fit::{Fit, Model};
use crate::model::optimum::ModelError;
use crate::search::acceptance::{Rival, TermEvidence};
use crate::search::alternative::Alternative;

/// Evidence and rivals of an accepted term.
#[derive(Debug, Clone, PartialEq)]
pub struct Accepted {
    /// Statistical evidence.
    pub evidence: TermEvidence,
    /// Rivals, nearest first.
    pub rivals: Vec<Rival>,
}

/// A candidate that was not accepted. Only the values of its fit are kept, as whole fits of all candidates
/// would fill the memory.
#[derive(Debug, Clone)]
pub struct Refused {
    /// The candidate effect.
    pub candidate: Candidate,
    /// Values of the model with the candidate, its own last; `None` when it was not worth a fit.
    pub values: Option<Vec<f64>>,
    /// The other terms of the model.
    pub beside: Vec<Candidate>,
    /// Gain in BIC over the model without the candidate, from the fit or estimated from the score.
    pub delta_bic: f64,
    /// Reason for the refusal.
    pub why: String,
    /// True for a candidate that met all conditions, and that another contradicts which explains as much.
    pub contested: bool,
}

impl Refused {
    /// The refused candidate of an alternative, with the reason.
    pub fn new(Alternative { candidate, optimum, beside, delta_bic, .. }: Alternative, why: String) -> Self {
        let values = optimum.map(|optimum| optimum.values);
        Self { candidate, values, beside, delta_bic, why, contested: false }
    }
}

/// Result of a search for causes.
#[derive(Debug, Clone)]
pub struct Selection<'r, 'd> {
    /// The model with all accepted terms.
    pub model: Model<'r, 'd>,
    /// The fit of the model.
    pub fit: Fit,
    /// The fit without any term.
    pub null: Fit,
    /// Evidence of each accepted term.
    pub accepted: Vec<Accepted>,
    /// Candidates that were refused beside the accepted ones, nearest first.
    pub refused: Vec<Refused>,
}

impl<'r, 'd> Selection<'r, 'd> {
    /// A selection without any term.
    ///
    /// # Errors
    /// When the vehicle cannot be simulated over the record.
    pub fn nothing(model: Model<'r, 'd>, start: Vec<f64>) -> Result<Self, ModelError> {
        let null = model.fit(start, None, None)?;
        Ok(Self { model, fit: null.clone(), null, accepted: Vec::new(), refused: Vec::new() })
    }
}

impl Selection<'_, '_> {
    /// The selection without some terms, refitted: from the given initial states and free parameters, or from its own where
    /// none are given. `None` when no term is dropped, or the refit fails.
    pub fn without(&self, dropped: &[usize], start: &[f64]) -> Option<Self> {
        (!dropped.is_empty()).then_some(())?;
        let mut kept = self.clone();
        kept.keep_terms(|term, _, _| !dropped.contains(&term));
        let base = kept.model.base().min(start.len());
        kept.fit.values.splice(..base, start.iter().copied().take(base));
        kept.fit = kept.model.fit(kept.fit.values.clone(), self.fit.profile.noise.shared(), None).ok()?;
        Some(kept)
    }

    /// Drops the unwanted terms with their values and evidence, without a refit.
    pub fn keep(&mut self, wanted: impl Fn(&Candidate) -> bool) {
        self.keep_terms(|_, candidate, _| wanted(candidate));
    }

    /// Drops terms as [`Selection::keep`], selected also by their index and values.
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
