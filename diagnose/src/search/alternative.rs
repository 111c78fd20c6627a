//! A candidate beside the terms of a model, and what a search knows when it fits one.

use crate::Watch;
use crate::candidates::library::{Candidate, Sizes};
use crate::model::fit::{Effort, Fit, Model};

/// A candidate beside the terms of a model, fitted together with them.
#[derive(Debug, Clone)]
pub struct Alternative {
    /// The candidate.
    pub candidate: Candidate,
    /// The fit of model and candidate; the candidate's values come last. `None` when it was not worth a fit.
    pub fit: Option<Fit>,
    /// The model's terms in that fit: those of a search's end may be others.
    pub beside: Vec<Candidate>,
    /// Gain in BIC over the model without it: by the fit, or estimated from the score.
    pub delta_bic: f64,
    /// Twice the gain in log-likelihood.
    pub ratio: f64,
}

/// What the search knows beside model and fit.
#[derive(Debug, Clone, Copy)]
pub struct SearchSpace<'s> {
    /// Candidates whose response follows from the inputs.
    pub library: &'s [Candidate],
    /// Sizes of the record.
    pub sizes: &'s Sizes,
    /// Causes that are named, at most.
    pub most: usize,
    /// Standard deviations of the channels' noise as the vehicle declares it; 0 where it says nothing.
    pub declared: &'s [f64],
    /// Who waits for the answer.
    pub watch: &'s Watch,
}

/// The model with the candidate, all values fitted.
pub fn fitted(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    start: Vec<f64>,
) -> Option<Alternative> {
    fitted_with(model, fit, candidate, start, Effort::Full)
}

/// As [`fitted`], as far as asked.
pub fn fitted_with(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    start: Vec<f64>,
    effort: Effort,
) -> Option<Alternative> {
    let mut values = fit.values.clone();
    values.extend(start);
    joined(model, fit, candidate, values, effort)
}

/// The model with the candidate, from all values together.
pub fn joined(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    values: Vec<f64>,
    effort: Effort,
) -> Option<Alternative> {
    let mut extended = model.clone();
    extended.terms.push(candidate.clone());
    let initial = &fit.columns[..model.states()];
    let result = extended.fit_with(values, fit.profile.noise.shared(), Some(initial), effort).ok()?;
    let delta_bic = fit.profile.bic(0) - result.profile.bic(candidate.tunables.len());
    let ratio = 2.0 * (result.profile.log_likelihood - fit.profile.log_likelihood);
    let beside = model.terms.clone();
    Some(Alternative { candidate: candidate.clone(), fit: Some(result), beside, delta_bic, ratio })
}
