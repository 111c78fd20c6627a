//! Order of surveyed candidates: each once, and the simpler of two equivalent ones first.

use crate::model::fit::{Effort, Fit, Model};
use crate::search::alternative::{Alternative, SearchSpace, joined};
use crate::search::equivalence::{simpler, single};
use whirlstand_vehicle::Kind;

/// Puts the simpler candidate first where the best is equivalent to it. With one input and one output, a
/// delay of the input is equivalent to one of the output and is attributed to the input. A tone that no other
/// output follows is attributed to the sensor.
pub(super) fn simpler_first(
    model: &Model<'_, '_>,
    fit: &Fit,
    space: &SearchSpace<'_>,
    alternatives: &mut Vec<(Alternative, Vec<f64>)>,
) {
    let data = model.free_run.data;
    let Some((first, _)) = alternatives.first() else { return };
    let Some((kind, same)) = simpler(first.candidate.kind, first.delta_bic, data) else { return };
    // On coarse samples the likelihood of a delay has local maxima: the equivalent starts where the best has
    // ended.
    let again = first.optimum.as_ref().filter(|_| single(data) && kind != Kind::Vibration).and_then(|best| {
        let candidate = space.library.iter().find(|c| c.kind == kind)?;
        joined(model, fit, candidate, best.values.clone(), Effort::Full)
    });
    let bic = first.delta_bic;
    if let Some(again) = again.filter(|t| bic - t.delta_bic < same) {
        let start = again.candidate.starts[0].clone();
        alternatives.retain(|(t, _)| t.candidate.kind != kind);
        alternatives.insert(0, (again, start));
    } else if let Some(i) = alternatives.iter().position(|(t, _)| t.candidate.kind == kind)
        && alternatives[i].0.optimum.is_some()
        && bic - alternatives[i].0.delta_bic < same
    {
        alternatives[..=i].rotate_right(1);
    }
}

/// Removes duplicates: both score tests often suggest the same event or tone. In a sorted list the better one
/// stays.
pub(super) fn once(alternatives: &mut Vec<(Alternative, Vec<f64>)>) {
    let mut kept: Vec<(String, Vec<f64>, f64)> = Vec::new();
    alternatives.retain(|(alternative, start)| {
        let name = alternative.candidate.name();
        let near = |other: &[f64]| {
            let mut pairs = start.iter().zip(other).zip(&alternative.candidate.tunables);
            other.len() == start.len()
                && pairs.all(|((a, b), t)| t.size || t.name == "phase_rad" || (a - b).abs() <= 3.0 * t.scale)
        };
        // A candidate whose noise was refitted has the same score when it is the same.
        let known = kept
            .iter()
            .any(|(n, other, bic)| *n == name && near(other) && (bic - alternative.delta_bic).abs() < 1.0);
        if !known {
            kept.push((name, start.clone(), alternative.delta_bic));
        }
        !known
    });
}
