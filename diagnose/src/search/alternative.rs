//! A candidate fitted beside the terms of a model, and the common inputs of a search.

use whirlstand_vehicle::Kind;

use crate::Watch;
use crate::candidates::library::{Candidate, Sizes};
use crate::model::fit::{Effort, Fit, Model};
use crate::model::optimum::Optimum;

/// A candidate beside the terms of a model, fitted together with them.
#[derive(Debug, Clone)]
pub struct Alternative {
    /// The candidate effect.
    pub candidate: Candidate,
    /// The optimum of model and candidate, the candidate's values last. `None` when it was not worth a fit.
    pub optimum: Option<Optimum>,
    /// The terms of the model in that fit; the final model may have others.
    pub beside: Vec<Candidate>,
    /// Gain in BIC over the model without the candidate, from the fit or estimated from the score.
    pub delta_bic: f64,
    /// Twice the gain in log-likelihood.
    pub ratio: f64,
}

impl Alternative {
    /// Model and candidate with their fit; `model` and `fit` are those beside which the candidate was fitted.
    /// `None` when it was not worth a fit.
    pub fn whole<'r, 'd>(&self, model: &Model<'r, 'd>, fit: &Fit) -> Option<(Model<'r, 'd>, Fit)> {
        let mut whole = model.clone();
        whole.terms.push(self.candidate.clone());
        let optimum = self.optimum.as_ref()?;
        let at = optimum.values.len() - self.candidate.tunables.len();
        let fit = whole.at_beside(fit, (&self.candidate, &optimum.values[at..]), at, optimum).ok()?;
        Some((whole, fit))
    }
}

/// Inputs of a search besides model and fit.
#[derive(Debug, Clone, Copy)]
pub struct SearchSpace<'s> {
    /// Candidates whose response follows from the inputs.
    pub library: &'s [Candidate],
    /// Magnitudes of the record's signals.
    pub sizes: &'s Sizes,
    /// Largest number of causes to name.
    pub most: usize,
    /// Standard deviations of the channels' declared noise; 0 where the vehicle declares none.
    pub declared: &'s [f64],
    /// Receives progress and can stop the search.
    pub watch: &'s Watch,
}

/// The model with the candidate added, all values fitted.
pub fn fitted(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    start: Vec<f64>,
) -> Option<Alternative> {
    fitted_with(model, fit, candidate, start, Effort::Full)
}

/// The model with the candidate, as [`fitted`], with the given effort.
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

/// Fits the model with the candidate, starting from the given values of all parameters: of all axes, or of the one on which
/// the candidate acts.
pub fn joined(
    model: &Model<'_, '_>,
    fit: &Fit,
    candidate: &Candidate,
    values: Vec<f64>,
    effort: Effort,
) -> Option<Alternative> {
    let mut extended = model.clone();
    extended.terms.push(candidate.clone());
    // Another mode answers to its initial state in another way from the first step on.
    let nearby = candidate.kind != Kind::ModeTransition;
    let initial = nearby.then(|| &fit.columns[..model.states()]);
    let own = &values[values.len() - candidate.tunables.len()..];
    let others = [&fit.values, own].concat();
    let result = extended.optimum_beside(fit, (candidate, own), (&values, others), initial, effort).ok()?;
    let delta_bic = fit.profile.bic(0) - result.profile.bic(candidate.tunables.len());
    let ratio = 2.0 * (result.profile.log_likelihood - fit.profile.log_likelihood);
    let beside = model.terms.clone();
    Some(Alternative { candidate: candidate.clone(), optimum: Some(result), beside, delta_bic, ratio })
}
