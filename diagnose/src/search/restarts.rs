//! The causes of a record: searched for in several ways, of which the likeliest counts.

use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::model::fit::Model;
use crate::model::free_run::ModelError;
use crate::search::alternative::SearchSpace;
use crate::search::mode_substitution::{Like, alternatives};
use crate::search::select::{Selection, select};
use crate::thresholds::{MODE_BEHIND_BIC, OVERSHADOWED_BIC};

/// The causes of a record. An unmodelled mode can be like several simpler causes together (a gain and a delay), and
/// what is chosen first is seldom left: the choice is made without modes too, or with one in their place.
///
/// # Errors
/// When the vehicle cannot be simulated over the record.
pub(crate) fn search<'r, 'd>(
    model: &Model<'r, 'd>,
    space: &SearchSpace<'_>,
) -> Result<Selection<'r, 'd>, ModelError> {
    let is_mode = |c: &Candidate| c.kind == Kind::UnmodelledMode;
    let mode = |s: &Selection<'_, '_>| s.model.terms.iter().any(is_mode);
    // One that is not determined hides what is less likely for itself, and more so together.
    let hiding = |s: &Selection<'_, '_>| {
        s.refused.iter().any(|(t, _)| is_mode(&t.candidate) && t.delta_bic > OVERSHADOWED_BIC)
    };
    let mut best = with_refit(model, space)?;
    if (mode(&best) || hiding(&best)) && !space.watch.is_stopped() {
        let others = space.library.iter().filter(|c| c.kind != Kind::UnmodelledMode);
        let simpler: Vec<Candidate> = others.cloned().collect();
        let without = with_refit(model, &SearchSpace { library: &simpler, ..*space });
        best = likelier(best, without.ok());
    }
    if mode(&best) || space.watch.is_stopped() {
        return Ok(best);
    }
    let begin = instead(&best, space);
    let other = begin.and_then(|begin| select(model.clone(), space, None, &begin).ok());
    // One cause is likelier beforehand than two: of as many names there are (Chen and Chen 2008, extended BIC).
    let name = 2.0 * (space.library.len().max(1) as f64).ln();
    let named = |s: &Selection<'_, '_>| bic(s) + name * s.model.terms.len() as f64;
    Ok(match other {
        Some(other) if named(&other) < named(&best) => other,
        _ => best,
    })
}

fn bic(selection: &Selection<'_, '_>) -> f64 {
    selection.fit.profile.bic(selection.model.parameters())
}

/// The one of smaller BIC.
fn likelier<'r, 'd>(best: Selection<'r, 'd>, other: Option<Selection<'r, 'd>>) -> Selection<'r, 'd> {
    match other {
        Some(other) if bic(&other) < bic(&best) => other,
        _ => best,
    }
}

/// Where free parameters are refitted beside the causes, the first is looked for beside the given values too: without
/// its cause, a refit may end far from anything (in a closed loop, at a vehicle that no command moves).
fn with_refit<'r, 'd>(
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

/// The terms of a selection with a mode in the place of a gain and what comes late into the same input; `None` where there
/// are no such, or the mode is worse.
fn instead(selection: &Selection<'_, '_>, space: &SearchSpace<'_>) -> Option<Vec<(Candidate, Vec<f64>)>> {
    let (model, fit) = (&selection.model, &selection.fit);
    let term = |place: Option<&str>, kinds: &[Kind]| {
        let all = model.terms.iter();
        let mut all = all.enumerate().filter(|(_, t)| place.is_none_or(|p| t.place == p));
        all.find(|(_, t)| kinds.contains(&t.kind)).map(|(i, t)| (i, t, fit.values[model.range(i)][0]))
    };
    let (gain, candidate, factor) = term(None, &[Kind::InputGain])?;
    let (late, _, late_s) = term(Some(&candidate.place), &[Kind::InputDelay, Kind::ActuatorLag])?;
    let like = Like { gain: factor, late_s: Some(late_s) };
    let mut reduced = model.clone();
    let mut values = fit.values.clone();
    for i in [gain.max(late), gain.min(late)] {
        values.drain(model.range(i));
        reduced.terms.remove(i);
    }
    let without =
        reduced.fit(values, fit.profile.noise.shared(), Some(&fit.columns[..model.states()])).ok()?;
    let alternatives = alternatives(&reduced, &without, &candidate.place, &like, space);
    let best = alternatives.into_iter().max_by(|a, b| a.delta_bic.total_cmp(&b.delta_bic))?;
    let own = without.profile.bic(reduced.parameters()) - fit.profile.bic(model.parameters());
    (best.delta_bic > own - MODE_BEHIND_BIC).then_some(())?;
    let values = best.fit?.values;
    reduced.terms.push(best.candidate);
    let terms = reduced.terms.iter().cloned().enumerate();
    Some(terms.map(|(i, t)| (t, values[reduced.range(i)].to_vec())).collect())
}
