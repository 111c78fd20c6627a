//! The order of what was surveyed: each once, and the simpler of two that are the same thing first.

use crate::model::fit::{Effort, Fit, Model};
use crate::search::alternative::{Alternative, SearchSpace, joined};
use crate::search::equivalence::{simpler, single};
use whirlstand_vehicle::Kind;

/// Where the best is the same thing as something simpler, that comes first. With one input and one output, a delay of the
/// one is a delay of the other: then it is the input's. A tone that no other output follows is the sensor's.
pub(super) fn simpler_first(
    model: &Model<'_, '_>,
    fit: &Fit,
    space: &SearchSpace<'_>,
    alternatives: &mut Vec<(Alternative, Vec<f64>)>,
) {
    let data = model.free_run.data;
    let Some((first, _)) = alternatives.first() else { return };
    let Some((kind, same)) = simpler(first.candidate.kind, first.delta_bic, data) else { return };
    // On coarse samples the likelihood of a delay has humps: the twin starts where the best has ended.
    let again = first.fit.as_ref().filter(|_| single(data) && kind != Kind::Vibration).and_then(|best| {
        let candidate = space.library.iter().find(|c| c.kind == kind)?;
        joined(model, fit, candidate, best.values.clone(), Effort::Full)
    });
    let bic = first.delta_bic;
    if let Some(again) = again.filter(|t| bic - t.delta_bic < same) {
        let start = again.candidate.starts[0].clone();
        alternatives.retain(|(t, _)| t.candidate.kind != kind);
        alternatives.insert(0, (again, start));
    } else if let Some(i) = alternatives.iter().position(|(t, _)| t.candidate.kind == kind)
        && alternatives[i].0.fit.is_some()
        && bic - alternatives[i].0.delta_bic < same
    {
        alternatives[..=i].rotate_right(1);
    }
}

/// Both score tests often suggest the same event or tone: once is enough. Sorted, the better one stays.
pub(super) fn once(alternatives: &mut Vec<(Alternative, Vec<f64>)>) {
    let mut kept: Vec<(String, Vec<f64>, f64)> = Vec::new();
    alternatives.retain(|(alternative, start)| {
        let name = alternative.candidate.name();
        let near = |other: &[f64]| {
            let mut pairs = start.iter().zip(other).zip(&alternative.candidate.tunables);
            other.len() == start.len()
                && pairs.all(|((a, b), t)| t.size || t.name == "phase_rad" || (a - b).abs() <= 3.0 * t.scale)
        };
        // The score of one whose noise was fitted anew is the same when it is the same.
        let known = kept
            .iter()
            .any(|(n, other, bic)| *n == name && near(other) && (bic - alternative.delta_bic).abs() < 1.0);
        if !known {
            kept.push((name, start.clone(), alternative.delta_bic));
        }
        !known
    });
}
