//! A mode of an actuator that looks like something simpler: a fast one like a gain, a slower one like a delay or a lag, and
//! one with a gain like two of these.
//!
//! The survey starts modes from a few frequencies and sees what each adds to a model without it. Beside a gain or a delay
//! that is hardly anything; in their place it may be as much, from a start that does what they did.

use crate::thresholds::{FAST_MODE_SHARES, IMITATING_PARAMETERS, MODE_DAMPING_RATIOS, MODE_LOG_RATIO};
use rayon::prelude::*;
use whirlstand_vehicle::Kind;

use crate::candidates::library::Candidate;
use crate::model::fit::{Effort, Fit, Model};
use crate::search::alternative::{Alternative, SearchSpace, fitted, followed};
use crate::search::survey_cache::Surveyed;

/// A mode in the place of `own`, as far as it explains what that does.
pub(crate) fn mode(
    model: &Model<'_, '_>,
    fit: &Fit,
    own: &Alternative,
    space: &SearchSpace<'_>,
) -> Option<Surveyed> {
    let value = *own.fit.as_ref()?.values.last()?;
    let like = match own.candidate.kind {
        Kind::InputGain => Like { gain: value, late_s: None },
        Kind::InputDelay | Kind::ActuatorLag => Like { gain: 1.0, late_s: Some(value) },
        _ => return None,
    };
    let best =
        alternatives(model, fit, &own.candidate.place, &like, space).into_iter().filter(|alternative| {
            let more = alternative.candidate.tunables.len() - own.candidate.tunables.len();
            more < IMITATING_PARAMETERS || alternative.ratio > own.ratio + MODE_LOG_RATIO
        });
    best.max_by(|a, b| a.delta_bic.total_cmp(&b.delta_bic)).as_ref().map(Surveyed::from)
}

/// What a mode is to be like.
pub(crate) struct Like {
    /// Its gain.
    pub gain: f64,
    /// Delay or time constant, s; `None` for a mode that is over before a sample.
    pub late_s: Option<f64>,
}

/// Modes of one input beside a model, each fitted from the likeliest of its starts.
pub(crate) fn alternatives(
    model: &Model<'_, '_>,
    fit: &Fit,
    input: &str,
    like: &Like,
    space: &SearchSpace<'_>,
) -> Vec<Alternative> {
    let half_hz = 0.5 / model.free_run.data.period_s;
    let starts: Vec<[f64; 2]> = match like.late_s {
        None => FAST_MODE_SHARES
            .into_iter()
            .flat_map(|share| MODE_DAMPING_RATIOS.map(|z| [share * half_hz, z]))
            .collect(),
        // What a mode does to a slow input is late by 2 damping / w.
        Some(late_s) => {
            let hz = |z: f64| z / (std::f64::consts::PI * late_s.max(1e-6));
            MODE_DAMPING_RATIOS.map(|z| [hz(z).min(0.9 * half_hz), z]).to_vec()
        }
    };
    let modes = space.library.iter().filter(|c| c.kind == Kind::UnmodelledMode && c.place == input);
    let modes: Vec<&Candidate> = modes.collect();
    if model.terms.iter().any(|t| modes.iter().any(|m| m.name() == t.name())) {
        return Vec::new();
    }
    let pairs: Vec<(&Candidate, [f64; 2])> =
        modes.iter().flat_map(|mode| starts.iter().map(move |start| (*mode, *start))).collect();
    let glances: Vec<Alternative> = pairs
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
