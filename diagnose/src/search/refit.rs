//! Searches for causes with refitted and with given free parameters, and keeps the likelier explanation.

use crate::candidates::library::Candidate;
use crate::model::fit::Model;
use crate::model::optimum::ModelError;
use crate::search::alternative::SearchSpace;
use crate::search::select::select;
use crate::search::selection::Selection;
use crate::thresholds::MIN_BIC_GAIN;

/// The causes of a record. Free parameters are estimates of the record to which they were fitted, and are refitted
/// beside the causes. The first cause is also searched for with the given values: without its cause, a refit may end
/// far from the truth (in a closed loop, at a vehicle that does not respond to commands).
///
/// Where the record contradicts the given values, something has changed since they were fitted: a cause beside the given
/// values, or all of them. A refit would hide a weaker actuator: it has to be clearly likelier.
///
/// # Errors
/// When the vehicle cannot be simulated over the record.
pub(crate) fn search<'r, 'd>(
    model: &Model<'r, 'd>,
    space: &SearchSpace<'_>,
) -> Result<Selection<'r, 'd>, ModelError> {
    if model.free.is_empty() || space.watch.is_stopped() {
        return select(model.clone(), space, None, &[]);
    }
    let given = Model { free: &[], ..model.clone() };
    let first = select(given.clone(), &SearchSpace { most: 1, ..*space }, None, &[]).ok();
    let Some(first) = first.filter(|s| !s.model.terms.is_empty()) else {
        return select(model.clone(), space, None, &[]);
    };
    let terms = terms(&first);
    let kept = if is_contradicted(model, &first) { select(given, space, None, &terms).ok() } else { None };
    if let Some(kept) = &kept
        && refit_gains(model, kept).is_some_and(|gain| gain < MIN_BIC_GAIN)
    {
        return Ok(kept.clone());
    }
    let anew = || select(model.clone(), space, None, &[]);
    let from_the_first = || select(model.clone(), space, None, &terms);
    let refitted = match rayon::join(anew, from_the_first) {
        (Ok(refitted), Ok(other)) if bic(&other) < bic(&refitted) => Ok(other),
        (Ok(refitted), _) => Ok(refitted),
        (Err(_), other) => other,
    };
    match (refitted, kept) {
        (Ok(refitted), Some(kept)) if bic(&kept) - bic(&refitted) < MIN_BIC_GAIN => Ok(kept),
        (refitted, _) => refitted,
    }
}

/// The causes of a selection, with their values.
fn terms(selection: &Selection<'_, '_>) -> Vec<(Candidate, Vec<f64>)> {
    let terms = selection.model.terms.iter().enumerate();
    terms.map(|(t, term)| (term.clone(), selection.fit.values[selection.model.range(t)].to_vec())).collect()
}

/// True when without causes the record is likelier with refitted than with given values, by BIC. On the record to which
/// they were fitted it is not.
fn is_contradicted(model: &Model<'_, '_>, given: &Selection<'_, '_>) -> bool {
    let refitted = model.fit(start(model, &given.null.values[..model.states()]), None, None);
    let null = given.null.profile.bic(0);
    refitted.is_ok_and(|refitted| null - refitted.profile.bic(model.free.len()) > MIN_BIC_GAIN)
}

/// Gain in BIC by refitting the free parameters beside the causes of a selection with given values; `None` where they
/// cannot be fitted.
fn refit_gains(model: &Model<'_, '_>, kept: &Selection<'_, '_>) -> Option<f64> {
    let (states, causes) = kept.fit.values.split_at(model.states());
    let whole = Model { terms: kept.model.terms.clone(), ..model.clone() };
    let fit = whole.fit([start(model, states).as_slice(), causes].concat(), None, None).ok()?;
    Some(bic(kept) - fit.profile.bic(whole.parameters()))
}

/// Initial states, and the free parameters as the vehicle has them.
fn start(model: &Model<'_, '_>, states: &[f64]) -> Vec<f64> {
    let vehicle = &model.free_run.vehicle;
    states.iter().copied().chain(model.free.iter().map(|free| vehicle.free_value(&free.target))).collect()
}

fn bic(selection: &Selection<'_, '_>) -> f64 {
    selection.fit.profile.bic(selection.model.parameters())
}
