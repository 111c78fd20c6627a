//! One cause in place of two.

use crate::candidates::library::Candidate;
use crate::model::fit::{Fit, Model};
use crate::model::optimum::ModelError;
use crate::search::acceptance::{Decision, decide};
use crate::search::alternative::{Alternative, SearchSpace, fitted};
use crate::search::survey::survey;
use crate::search::without::without;

/// The model with one cause in place of two of the same signal, where it does as well: a mode of an actuator
/// resembles a gain and a delay together, and a mode of gain 1 beside a gain is one of another gain. An early
/// choice is seldom revised. `hypotheses` is the number of candidates tested at once.
///
/// # Errors
/// When the vehicle cannot be simulated over the record.
pub fn merged<'r, 'd>(
    model: &Model<'r, 'd>,
    fit: &Fit,
    space: &SearchSpace<'_>,
    hypotheses: usize,
) -> Result<Option<(Model<'r, 'd>, Fit)>, ModelError> {
    // One cause is a priori more likely than two, depending on the number of names (Chen and Chen 2008,
    // extended BIC).
    let name = 2.0 * (space.library.len().max(1) as f64).ln();
    let terms = &model.terms;
    let pairs = (0..terms.len()).flat_map(|i| (i + 1..terms.len()).map(move |j| (i, j)));
    for (i, j) in pairs.filter(|(i, j)| terms[*i].place == terms[*j].place) {
        if space.watch.is_stopped() {
            break;
        }
        let (one, rest) = without(model, fit, j)?;
        let (reduced, rest) = without(&one, &rest, i)?;
        let own =
            |c: &&Candidate| c.place == terms[i].place && ![terms[i].kind, terms[j].kind].contains(&c.kind);
        let own: Vec<Candidate> = space.library.iter().filter(own).cloned().collect();
        let others = SearchSpace { library: &own, ..*space };
        let both = rest.profile.bic(reduced.parameters()) - fit.profile.bic(model.parameters());
        let freer = [i, j].into_iter().flat_map(|term| {
            let (term, values) = (&terms[term], &fit.values[model.range(term)]);
            freer(&reduced, &rest, (term, values), space)
        });
        let alternatives = freer.chain(survey(&reduced, &rest, &others));
        let mut single = alternatives.filter(|t| t.optimum.is_some() && t.delta_bic + name > both);
        let single = single.find(|t| matches!(decide(&reduced, &rest, t, hypotheses), Decision::Accepted(_)));
        if let Some(better) = single.and_then(|single| single.whole(&reduced, &rest)) {
            return Ok(Some(better));
        }
    }
    Ok(None)
}

/// A cause with parameters free that are fixed in it, fitted from its values.
fn freer(
    model: &Model<'_, '_>,
    fit: &Fit,
    (cause, values): (&Candidate, &[f64]),
    space: &SearchSpace<'_>,
) -> Vec<Alternative> {
    let known = cause.tunables.iter().zip(values).map(|(tunable, value)| (tunable.name, *value));
    let known: Vec<(&str, f64)> = known.chain(cause.fixed.iter().map(|(t, v)| (t.name, *v))).collect();
    let start = |c: &Candidate| -> Option<Vec<f64>> {
        c.tunables.iter().map(|t| known.iter().find(|k| k.0 == t.name).map(|k| k.1)).collect()
    };
    let is_freer = |c: &&Candidate| c.name() == cause.name() && c.fixed.len() < cause.fixed.len();
    space.library.iter().filter(is_freer).filter_map(|c| fitted(model, fit, c, start(c)?)).collect()
}
