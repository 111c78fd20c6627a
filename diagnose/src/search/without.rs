//! A model without one of its causes.

use crate::model::fit::{Effort, Fit, Model};
use crate::model::optimum::ModelError;

/// The model without a term, refitted.
///
/// # Errors
/// When the vehicle cannot be simulated over the record.
pub fn without<'r, 'd>(
    model: &Model<'r, 'd>,
    fit: &Fit,
    term: usize,
) -> Result<(Model<'r, 'd>, Fit), ModelError> {
    let mut reduced = model.clone();
    let range = model.range(term);
    let at = range.start;
    reduced.terms.remove(term);
    let mut values = fit.values.clone();
    let own: Vec<f64> = values.drain(range).collect();
    let initial = &fit.columns[..model.states()];
    let changed = (&model.terms[term], own.as_slice());
    let optimum =
        reduced.optimum_beside(fit, changed, (&values, values.clone()), Some(initial), Effort::Full)?;
    let without = reduced.at_beside(fit, changed, at, &optimum)?;
    Ok((reduced, without))
}
