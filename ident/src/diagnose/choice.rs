//! The causes of a record: searched for in several ways, of which the likeliest counts.

use whirlstand_vehicle::Kind;

use super::library::Candidate;
use super::model::Model;
use super::modes::instead;
use super::select::{OVERSHADOWED, Selection, select};
use super::survey::Scene;

/// The causes of a record. An unmodelled mode can be like several simpler causes together (a gain and a delay), and
/// what is chosen first is seldom left: the choice is made without modes too, or with one in their place.
pub(super) fn chosen<'r, 'd>(model: &Model<'r, 'd>, scene: &Scene<'_>) -> Option<Selection<'r, 'd>> {
    let is_mode = |c: &Candidate| c.kind == Kind::UnmodelledMode;
    let mode = |s: &Selection<'_, '_>| s.model.terms.iter().any(is_mode);
    // One that is not determined hides what is less likely for itself, and more so together.
    let hiding = |s: &Selection<'_, '_>| {
        s.refused.iter().any(|(t, _)| is_mode(&t.candidate) && t.delta_bic > OVERSHADOWED)
    };
    let mut best = beside_free(model, scene);
    if best.as_ref().is_some_and(|s| mode(s) || hiding(s)) {
        let others = scene.library.iter().filter(|c| c.kind != Kind::UnmodelledMode);
        let simpler: Vec<Candidate> = others.cloned().collect();
        best = likelier(best, beside_free(model, &Scene { library: &simpler, ..*scene }));
    }
    if best.as_ref().is_some_and(mode) {
        return best;
    }
    let begin = best.as_ref().and_then(|s| instead(s, scene));
    let other = begin.and_then(|begin| select(model.clone(), scene, None, &begin));
    // One cause is likelier beforehand than two: of as many names there are (Chen and Chen 2008, extended BIC).
    let name = 2.0 * (scene.library.len().max(1) as f64).ln();
    let named = |s: &Selection<'_, '_>| bic(s) + name * s.model.terms.len() as f64;
    match (best, other) {
        (Some(best), Some(other)) => Some(if named(&other) < named(&best) { other } else { best }),
        (best, other) => best.or(other),
    }
}

fn bic(selection: &Selection<'_, '_>) -> f64 {
    selection.fit.profile.bic(selection.model.parameters())
}

/// The one of smaller BIC.
fn likelier<'r, 'd>(a: Option<Selection<'r, 'd>>, b: Option<Selection<'r, 'd>>) -> Option<Selection<'r, 'd>> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if bic(&b) < bic(&a) { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// Where free parameters are refitted beside the causes, the first is looked for beside the given values too: without
/// its cause, a refit may end far from anything (in a closed loop, at a vehicle that no command moves).
fn beside_free<'r, 'd>(model: &Model<'r, 'd>, scene: &Scene<'_>) -> Option<Selection<'r, 'd>> {
    let refitted = select(model.clone(), scene, None, &[]);
    if model.free.is_empty() {
        return refitted;
    }
    let given = Model { free: &[], ..model.clone() };
    let beside_given = select(given, &Scene { most: 1, ..*scene }, None, &[]).and_then(|s| {
        let terms: Vec<_> = (0..s.model.terms.len())
            .map(|t| (s.model.terms[t].clone(), s.fit.values[s.model.range(t)].to_vec()))
            .collect();
        if terms.is_empty() { None } else { select(model.clone(), scene, None, &terms) }
    });
    likelier(refitted, beside_given)
}
