//! Searches for causes with refitted and with given free parameters, and keeps the more likely result.

use crate::model::fit::Model;
use crate::model::free_run::ModelError;
use crate::search::alternative::SearchSpace;
use crate::search::select::select;
use crate::search::selection::Selection;

/// The causes of a record. Where free parameters are refitted beside the causes, the first cause is also
/// searched for with the given values: without its cause, a refit may end far from the truth (in a closed
/// loop, at a vehicle that does not respond to commands).
///
/// # Errors
/// When the vehicle cannot be simulated over the record.
pub(crate) fn search<'r, 'd>(
    model: &Model<'r, 'd>,
    space: &SearchSpace<'_>,
) -> Result<Selection<'r, 'd>, ModelError> {
    let refitted = select(model.clone(), space, None, &[]);
    if model.free.is_empty() || space.watch.is_stopped() {
        return refitted;
    }
    let given = Model { free: &[], ..model.clone() };
    let first = select(given, &SearchSpace { most: 1, ..*space }, None, &[]).ok();
    let beside_given = first.filter(|s| !s.model.terms.is_empty()).and_then(|s| {
        let terms = s.model.terms.iter().enumerate();
        let terms: Vec<_> =
            terms.map(|(t, term)| (term.clone(), s.fit.values[s.model.range(t)].to_vec())).collect();
        select(model.clone(), space, None, &terms).ok()
    });
    match (refitted, beside_given) {
        (Ok(refitted), other) => Ok(likelier(refitted, other)),
        (Err(_), Some(other)) => Ok(other),
        (Err(why), None) => Err(why),
    }
}

fn bic(selection: &Selection<'_, '_>) -> f64 {
    selection.fit.profile.bic(selection.model.parameters())
}

/// The selection with the smaller BIC.
fn likelier<'r, 'd>(best: Selection<'r, 'd>, other: Option<Selection<'r, 'd>>) -> Selection<'r, 'd> {
    match other {
        Some(other) if bic(&other) < bic(&best) => other,
        _ => best,
    }
}
