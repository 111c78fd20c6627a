//! Agreement of two filters about the size of a cause.
//!
//! Causes are searched for with the longest memory, because process noise absorbs them. Its noise model is then not the
//! likeliest, and what the commands take from the outputs' noise (in closed loop), or a predicted output from the noise
//! of another, biases a size (Ljung, System Identification, 1999, 13.4). The likeliest filter is less biased and less
//! certain: a cause whose size differs between the two by more than chance allows is one of the noise model (Hausman,
//! Specification tests in econometrics, Econometrica 46, 1978).

use whirlstand_logs::shown::number;
use whirlstand_vehicle::Kind;

use crate::model::fit::{Fit, Model};
use crate::model::state_filter::follow;
use crate::thresholds::{DISAGREEMENT_SIGMAS, MAX_RELATIVE_ERROR};

/// A term whose size the likeliest filter contradicts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Contradicted {
    /// Index of the term.
    pub term: usize,
    /// What the two filters say.
    pub why: String,
}

/// The term of a model that the likeliest filter contradicts most, beside all others. `None` where it contradicts none,
/// cannot predict, or is the model's own.
pub(crate) fn contradicted(model: &Model<'_, '_>, fit: &Fit) -> Option<Contradicted> {
    let data = model.free_run.data;
    let filter = data.likeliest_filter.as_deref().filter(|_| !model.terms.is_empty())?;
    // The states of another mode are those of the vehicle alone.
    let modes = model.terms.iter().any(|term| term.kind == Kind::ModeTransition);
    let own = !filter.forced && filter.memories_s.iter().all(|s| Some(*s) == data.memory_s);
    if own || filter.forced && modes {
        return None;
    }
    let followed = follow(data);
    let free_run = filter.runs(&model.free_run.vehicle, &followed)?;
    let other = Model { free_run: &free_run, free: model.free, terms: model.terms.clone() };
    let at_rest = vec![0.0; free_run.states() - model.free_run.states()];
    let (initial, others) = fit.values.split_at(model.states());
    let start = |others: &[f64]| -> Vec<f64> {
        let states = initial.chunks_exact(model.free_run.states());
        states.flat_map(|x| x.iter().chain(&at_rest)).chain(others).copied().collect()
    };
    // Where its predictions diverge with the sizes as they are, it finds its own from causes without effect.
    let again = other.fit(start(others), None, None).or_else(|_| {
        let mut values = fit.values.clone();
        for (term, candidate) in model.terms.iter().enumerate() {
            values[model.range(term).end - 1] = candidate.null;
        }
        other.fit(start(&values[model.states()..]), None, None)
    });
    let again = again.ok()?;
    let (covariance, spread) = (model.covariance(fit).ok()?, other.covariance(&again).ok()?);
    let more = again.values.len() - fit.values.len();
    let sizes = model.terms.iter().enumerate().flat_map(|(term, candidate)| {
        let sizes = candidate.tunables.iter().enumerate().filter(|(_, tunable)| tunable.size);
        sizes.map(move |(i, tunable)| (term, candidate, i, tunable))
    });
    let beyond = sizes.filter_map(|(term, candidate, i, tunable)| {
        let at = model.range(term).start + i;
        let null = if i + 1 == candidate.tunables.len() { candidate.null } else { 0.0 };
        let (own, theirs) = (fit.values[at], again.values[more + at]);
        let apart = (own - theirs).abs();
        let chance = (covariance[(at, at)] + spread[(more + at, more + at)]).max(0.0).sqrt();
        let beyond = apart > DISAGREEMENT_SIGMAS * chance && apart > MAX_RELATIVE_ERROR * (own - null).abs();
        let by = |s: f64| format!("a filter with a memory of {} s", number(s));
        let why = || {
            format!(
                "its {} depends on the noise model: {} by {}, {} by the likeliest filter",
                tunable.name,
                number(own),
                data.memory_s.map_or("a free run".into(), by),
                number(theirs)
            )
        };
        beyond.then(|| (apart / chance, Contradicted { term, why: why() }))
    });
    beyond.max_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, contradicted)| contradicted)
}
