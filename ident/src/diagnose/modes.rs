//! A mode of an actuator that looks like something simpler: a fast one like a gain, a slower one like a delay or a lag, and
//! one with a gain like two of these.
//!
//! The survey starts modes from a few frequencies and sees what each adds to a model without it. Beside a gain or a delay
//! that is hardly anything; in their place it may be as much, from a start that does what they did.

use rayon::prelude::*;
use whirlstand_vehicle::Kind;

use super::library::Candidate;
use super::model::{Effort, Fit, Model};
use super::select::Selection;
use super::survey::{Scene, Trial, fitted, followed};
use super::surveys::Seen;

/// Damping ratios that are tried.
const DAMPING: [f64; 3] = [0.1, 0.4, 0.9];
/// Frequencies of a mode like a gain, as shares of the highest that the record shows.
const FAST: [f64; 3] = [0.25, 0.45, 0.7];
/// A mode with so many numbers more than the simpler cause is one of several that imitate it, if it explains no more.
const MORE: usize = 2;
/// More is twice the logarithm of the likelihood from here on.
const BETTER: f64 = 6.0;
/// A mode this much behind several causes in BIC may still pass them when the others are chosen beside it.
const BEHIND: f64 = 20.0;

/// A mode in the place of `own`, as far as it explains what that does.
pub(super) fn mode(model: &Model<'_, '_>, fit: &Fit, own: &Trial, scene: &Scene<'_>) -> Option<Seen> {
    let value = *own.fit.as_ref()?.values.last()?;
    let like = match own.candidate.kind {
        Kind::InputGain => Like { gain: value, late_s: None },
        Kind::InputDelay | Kind::ActuatorLag => Like { gain: 1.0, late_s: Some(value) },
        _ => return None,
    };
    let best = trials(model, fit, &own.candidate.place, &like, scene).into_iter().filter(|trial| {
        let more = trial.candidate.tunables.len() - own.candidate.tunables.len();
        more < MORE || trial.ratio > own.ratio + BETTER
    });
    best.max_by(|a, b| a.delta_bic.total_cmp(&b.delta_bic)).as_ref().map(Seen::from)
}

/// The terms of a selection with a mode in the place of a gain and what comes late into the same input; `None` where there
/// are no such, or the mode is worse.
pub(super) fn instead(
    selection: &Selection<'_, '_>,
    scene: &Scene<'_>,
) -> Option<Vec<(Candidate, Vec<f64>)>> {
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
    let without = reduced.fit(values, fit.profile.noise.shared(), Some(&fit.columns[..model.states()]))?;
    let trials = trials(&reduced, &without, &candidate.place, &like, scene);
    let best = trials.into_iter().max_by(|a, b| a.delta_bic.total_cmp(&b.delta_bic))?;
    let own = without.profile.bic(reduced.parameters()) - fit.profile.bic(model.parameters());
    (best.delta_bic > own - BEHIND).then_some(())?;
    let values = best.fit?.values;
    reduced.terms.push(best.candidate);
    let terms = reduced.terms.iter().cloned().enumerate();
    Some(terms.map(|(i, t)| (t, values[reduced.range(i)].to_vec())).collect())
}

/// What a mode is to be like.
struct Like {
    gain: f64,
    /// Delay or time constant, s; `None` for a mode that is over before a sample.
    late_s: Option<f64>,
}

/// Modes of one input beside a model, each fitted from the likeliest of its starts.
fn trials(model: &Model<'_, '_>, fit: &Fit, input: &str, like: &Like, scene: &Scene<'_>) -> Vec<Trial> {
    let half_hz = 0.5 / model.runner.data.period_s;
    let starts: Vec<[f64; 2]> = match like.late_s {
        None => FAST.into_iter().flat_map(|share| DAMPING.map(|z| [share * half_hz, z])).collect(),
        // What a mode does to a slow input is late by 2 damping / w.
        Some(late_s) => {
            let hz = |z: f64| z / (std::f64::consts::PI * late_s.max(1e-6));
            DAMPING.map(|z| [hz(z).min(0.9 * half_hz), z]).to_vec()
        }
    };
    let modes = scene.library.iter().filter(|c| c.kind == Kind::UnmodelledMode && c.place == input);
    let modes: Vec<&Candidate> = modes.collect();
    if model.terms.iter().any(|t| modes.iter().any(|m| m.name() == t.name())) {
        return Vec::new();
    }
    let pairs: Vec<(&Candidate, [f64; 2])> =
        modes.iter().flat_map(|mode| starts.iter().map(move |start| (*mode, *start))).collect();
    let glances: Vec<Trial> = pairs
        .into_par_iter()
        .filter_map(|(mode, [hz, damping])| {
            let open = mode.tunables.iter().zip([hz, damping, like.gain]);
            let values = open.map(|(t, v)| v.clamp(t.lower, t.upper)).collect();
            followed(model, fit, mode, values, Effort::Glance)
        })
        .collect();
    let best = modes.par_iter().filter_map(|mode| {
        let own = glances.iter().filter(|g| g.candidate.is_same(mode));
        let values = &own.max_by(|a, b| a.delta_bic.total_cmp(&b.delta_bic))?.fit.as_ref()?.values;
        fitted(model, fit, mode, values[values.len() - mode.tunables.len()..].to_vec())
    });
    best.collect()
}
