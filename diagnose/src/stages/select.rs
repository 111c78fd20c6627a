//! Select stage: searches for the causes of the record.

use super::baseline::Baseline;
use crate::data::record::Data;
use crate::model::fit::{Fit, Model};
use crate::model::free_run::FreeRun;
use crate::model::optimum::ModelError;
use crate::search::refit::search;
use crate::search::selection::Selection;
use crate::thresholds::{BEGINNING_S, REST_BEFORE_BIC};
use whirlstand_vehicle::Kind;

/// The causes with the largest gain, before their residual is analysed.
#[derive(Debug, Clone)]
pub(crate) struct Selected<'r> {
    pub baseline: &'r Baseline<'r>,
    pub model: Model<'r, 'r>,
    pub selection: Selection<'r, 'r>,
}

impl<'r> Selected<'r> {
    /// Searches for the causes; `free_run` must be of the baseline's data.
    ///
    /// # Errors
    /// When the vehicle cannot be simulated over the record.
    pub fn new(baseline: &'r Baseline<'r>, free_run: &'r FreeRun<'r>) -> Result<Self, ModelError> {
        let model = baseline.model(free_run);
        let selection = if baseline.blocked {
            Selection::nothing(model.clone(), baseline.start())?
        } else {
            search(&model, &baseline.space())?
        };
        // Where the given values are likelier, they are kept from here on.
        let model = Model { free: selection.model.free, ..model };
        Ok(Self { baseline, model, selection })
    }
}

/// True when the inputs were rather at rest before the records: the same causes then gain enough in BIC. A
/// disturbance at the very beginning may imitate that. It is left out, and as the first command can then not have been
/// held without it, any gain is enough.
pub(crate) fn rest_before(selection: &Selection<'_, '_>) -> bool {
    let own = selection.model.free_run.data;
    let data = Data { held: false, ..own.clone() };
    let free_run = FreeRun::new(&selection.model.free_run.vehicle, &data);
    let mut rest = selection.clone();
    rest.keep_terms(|_, candidate, values| {
        let at = candidate.tunables.iter().position(|t| t.name == "at_s");
        !(candidate.kind == Kind::PulseDisturbance
            && at.is_some_and(|i| values[i] < own.times_s().0 + BEGINNING_S))
    });
    let model = Model { free_run: &free_run, free: selection.model.free, terms: rest.model.terms.clone() };
    let other = model.fit(rest.fit.values, selection.fit.profile.noise.shared(), None);
    let bic = |fit: &Fit, model: &Model<'_, '_>| fit.profile.bic(model.parameters());
    let imitated = model.terms.len() < selection.model.terms.len();
    let enough = if imitated { 0.0 } else { REST_BEFORE_BIC };
    other.is_ok_and(|other| bic(&selection.fit, &selection.model) - bic(&other, &model) > enough)
}
