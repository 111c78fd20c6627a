//! Selects the structure of one output by predictions of held-out data.

use rayon::prelude::*;
use whirlstand_vehicle::{Matrix, Target, Vehicle};

use super::ahead::{Inputs, forecasts};
use super::blocks::{LeadIn, Pair, warm};
use super::comparison::{compare, takes_away};
use super::error::DraftError;
use super::own_past::{Ahead, Memory, Regression, lags, starts};
use super::structure::{Signals, Structure};
use crate::identify::Segment;
use crate::identify::fitted::Fit;
use crate::identify::force_fit::fit_beside_forces;
use crate::identify::problem::{Nuisance, Parameter, Problem};
use crate::watch::Watch;

/// Standard errors by which a more complex structure must predict better than a simpler one (Breiman,
/// Friedman, Olshen and Stone, Classification and Regression Trees, 1984, section 3.4.3: the
/// one-standard-error rule).
const BETTER_SIGMAS: f64 = 1.0;

/// Ratio of mean square errors above which the simpler structure is not taken either: a lag shows only in the
/// few manoeuvres, too few to be significant in standard errors.
const BETTER_SHARE: f64 = 1.02;

/// Start values of a delay, s: several are tried, as the cost has local minima.
const START_DELAYS_S: [f64; 3] = [0.01, 0.03, 0.08];

/// A fitted structure with its errors on held-out data.
#[derive(Debug, Clone)]
pub struct Tried {
    /// Structure that was fitted.
    pub structure: Structure,
    /// Fit to the fitted data.
    pub fit: Fit,
    /// Errors of its forecasts at the horizon on the held-out data.
    pub errors: Vec<f64>,
    /// The same with the memory that its noise lacks ([`Memory`]): what it knows of the input, however well its noise fits.
    pub completed: Vec<f64>,
    /// Root mean square of the former, SI.
    pub rmse: f64,
}

/// The selected structure with its fit, and the errors of all structures.
pub type Choice = (Tried, Vec<(Structure, f64)>);

/// Fits every structure and selects the simplest of those that predict as well as the best; also returns the
/// root mean square errors of all. `own_past` are the errors of the output's own past on the held-out data.
///
/// # Errors
/// When none can be fitted.
pub fn select(
    pair: &Pair,
    signals: &Signals,
    horizon: usize,
    own_past: &[f64],
) -> Result<Option<Choice>, DraftError> {
    let mut all: Vec<Tried> = Vec::new();
    // Each starts from the results of those with one effect less.
    for effects in 0..=2 {
        let wanted = |s: &Structure| s.effects() == effects && s.agrees(signals.actuators.as_ref());
        let next: Vec<Structure> = Structure::all().into_iter().filter(wanted).collect();
        let found = next.par_iter().map(|s| {
            let simpler = all.iter().filter(|t| s.extends(&t.structure)).map(|t| &t.fit).collect::<Vec<_>>();
            tried(*s, pair, signals, horizon, &simpler)
        });
        let found: Vec<Option<Tried>> = found.collect::<Result<_, _>>()?;
        all.extend(found.into_iter().flatten());
    }
    begin_at_richer(&mut all, pair, signals, horizon)?;
    all.retain(|t| t.rmse.is_finite());
    all.sort_by(|a, b| {
        (a.structure.parameters(), a.rmse).partial_cmp(&(b.structure.parameters(), b.rmse)).expect("finite")
    });
    let figures = all.iter().map(|t| (t.structure, t.rmse)).collect();
    all.retain(effects_show);
    // A structure whose own gain it does not determine has too many parameters for the record.
    if all.iter().any(answers_the_input) {
        all.retain(answers_the_input);
    }
    Ok(simplest(all, own_past).map(|found| (found, figures)))
}

/// Fits structures again from a richer one that is likelier although its further effect does not show: a search that ended
/// in another valley of the likelihood.
fn begin_at_richer(
    all: &mut [Tried],
    pair: &Pair,
    signals: &Signals,
    horizon: usize,
) -> Result<(), DraftError> {
    for i in 0..all.len() {
        let own = &all[i];
        let richer =
            |t: &&Tried| t.structure.extends(&own.structure) && !effects_show(t) && t.fit.cost < own.fit.cost;
        let Some(likelier) = all.iter().filter(richer).min_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost))
        else {
            continue;
        };
        if let Some(found) = tried(own.structure, pair, signals, horizon, &[&likelier.fit])?
            && found.fit.cost < own.fit.cost
        {
            all[i] = found;
        }
    }
    Ok(())
}

/// Standard errors by which the gain of the input must differ from zero. It is the largest of eight structures for each pair
/// of an input and an output, so that two standard errors come about by chance.
const ACTING_SIGMAS: f64 = 3.0;

/// True when the gain of the input is determined and differs from zero: a model with random-walk forces predicts an output
/// better than a regression on its past even without any response to the input.
pub fn answers_the_input(tried: &Tried) -> bool {
    let of_input = |p: &Parameter| matches!(p.target, Target::Entry(Matrix::B, ..));
    let parameters = &tried.fit.problem.parameters;
    parameters
        .iter()
        .enumerate()
        .any(|(i, p)| of_input(p) && tried.fit.theta[i].abs() > ACTING_SIGMAS * sigma(&tried.fit, i))
}

fn sigma(fit: &Fit, i: usize) -> f64 {
    fit.covariance[(i, i)].max(0.0).sqrt()
}

/// True when every delay and lag is determined, more than two standard errors from zero, and above its lower bound: one that
/// rests there would be less (Self and Liang 1987).
fn effects_show(tried: &Tried) -> bool {
    let fit = &tried.fit;
    let shows = |i: usize, p: &Parameter| fit.theta[i] > (2.0 * sigma(fit, i)).max(p.lower + bound_margin(p));
    let of_effect = |p: &Parameter| matches!(p.target, Target::Effect(..));
    fit.fixed.iter().all(|f| !of_effect(&f.parameter))
        && fit.problem.parameters.iter().enumerate().all(|(i, p)| !of_effect(p) || shows(i, p))
}

/// Distance to a bound within which a value rests there.
fn bound_margin(parameter: &Parameter) -> f64 {
    1e-6 * (parameter.upper - parameter.lower)
}

/// True when every entry of the matrices is away from its bounds.
fn within_bounds(tried: &Tried) -> bool {
    let inside = |(p, value): (&Parameter, &f64)| {
        let margin = bound_margin(p);
        !matches!(p.target, Target::Entry(..)) || (p.lower + margin..=p.upper - margin).contains(value)
    };
    tried.fit.problem.parameters.iter().zip(&tried.fit.theta).all(inside)
}

/// The simplest of those that predict as well as the best; `all` is sorted from the simplest on. A value at its bound is not
/// determined (Self and Liang 1987): of structures that predict equally well, those without one come first.
///
/// Where none predicts better than the output's own past, the noise of all lacks a memory, and they are compared with it.
/// Elsewhere the noise tells structures apart as well: what disturbs a vehicle does not pass its actuators.
fn simplest(mut all: Vec<Tried>, own_past: &[f64]) -> Option<Tried> {
    let suffices = |t: &Tried| compare(own_past, &t.errors).is_some_and(|c| takes_away(&c));
    let sufficient = all.iter().any(suffices);
    let errors: fn(&Tried) -> &[f64] = if sufficient { |t| &t.errors } else { |t| &t.completed };
    let mean_square = |t: &Tried| compare(errors(t), errors(t)).map_or(f64::INFINITY, |c| c.first);
    let best = all.iter().min_by(|a, b| mean_square(a).total_cmp(&mean_square(b)))?;
    let as_good = |t: &Tried| {
        compare(errors(t), errors(best))
            .is_none_or(|c| c.sigmas < BETTER_SIGMAS && c.first < BETTER_SHARE * c.second)
    };
    let inside = all.iter().position(|t| as_good(t) && within_bounds(t));
    let at = inside.or_else(|| all.iter().position(as_good))?;
    Some(all.swap_remove(at))
}

/// A structure fitted to other data of the same signals; `None` when no start converges.
///
/// # Errors
/// As [`select`].
pub fn refitted(
    before: &Tried,
    pair: &Pair,
    signals: &Signals,
    horizon: usize,
) -> Result<Option<Tried>, DraftError> {
    tried(before.structure, pair, signals, horizon, &[&before.fit])
}

/// Fits one structure; `None` when no start converges.
fn tried(
    structure: Structure,
    pair: &Pair,
    signals: &Signals,
    horizon: usize,
    simpler: &[&Fit],
) -> Result<Option<Tried>, DraftError> {
    let vehicle = structure.vehicle(signals)?;
    let problem = Problem::new(&vehicle, &pair.fitted, Nuisance::default())?;
    let extra: Vec<Vec<f64>> =
        simpler.iter().flat_map(|fit| extended_starts(&vehicle, &problem, fit)).collect();
    let Ok(fit) = fit_beside_forces(&problem, &pair.fitted, &extra, &Watch::default()) else {
        return Ok(None);
    };
    let Some((errors, completed)) = held_out_errors(&fit, pair, horizon) else { return Ok(None) };
    let known: Vec<f64> = errors.iter().copied().filter(|e| e.is_finite()).collect();
    let rmse = if known.is_empty() { f64::NAN } else { whirlstand_logs::stats::rms(&known) };
    Ok(Some(Tried { structure, fit, errors, completed, rmse }))
}

/// Forecasts of a segment by one fit.
struct Forecasts {
    /// Innovations of all steps.
    innovations: Vec<f64>,
    /// Last known step and error of each forecast.
    errors: Vec<(usize, f64)>,
}

/// Errors of a fit's forecasts on the held-out data: alone, and with the memory that its noise lacks, where that predicts
/// better.
fn held_out_errors(fit: &Fit, pair: &Pair, horizon: usize) -> Option<(Vec<f64>, Vec<f64>)> {
    let (lags, warm) = (lags(pair.period_s), warm(pair, horizon));
    let expected = match pair.reacts {
        true => Some(Regression::fit(&pair.fitted, lags, lags, Ahead::Inputs(horizon))?),
        false => None,
    };
    let inputs = Inputs { steps: horizon, expected: expected.as_ref() };
    let made = |s: &Segment, from: Vec<usize>| -> Option<Forecasts> {
        let (forecasts, innovations) = forecasts(fit, &inputs, s, &from)?;
        let errors = from.iter().zip(forecasts).map(|(k, forecast)| (*k, s.outputs[k + horizon] - forecast));
        Some(Forecasts { innovations, errors: errors.collect() })
    };
    // Forecasts from neighbouring steps have most of their errors in common.
    let apart = (horizon / 4).max(1);
    let everywhere = |s: &Segment| (warm..s.steps.saturating_sub(horizon)).step_by(apart).collect();
    let fitted = pair.fitted.iter().map(|s| made(s, everywhere(s))).collect::<Option<Vec<_>>>()?;
    let fitted =
        fitted.iter().flat_map(|f| f.errors.iter().map(|(k, error)| (&f.innovations[..=*k], *error)));
    let memory = Memory::fit(fitted, lags)?;
    let (mut alone, mut completed) = (Vec::new(), Vec::new());
    for (s, LeadIn { segment, lead }) in pair.held().iter().zip(&pair.lead_ins) {
        let from = starts(s, warm, horizon).into_iter().map(|k| lead + k).collect();
        let Forecasts { innovations, errors } = made(segment, from)?;
        for (k, error) in errors {
            alone.push(error);
            completed.push(memory.left(&innovations[..=k], error));
        }
    }
    let worse = compare(&completed, &alone).is_some_and(|c| c.first > c.second);
    Some(if worse { (alone.clone(), alone) } else { (alone, completed) })
}

/// Starts for a structure with one more effect: results of the simpler structure, with short and longer
/// delays and lags. None grows: without the lag of its actuators, a vehicle in a closed loop seems to be more unstable than
/// it is, and a search that begins there stays there.
fn extended_starts(vehicle: &Vehicle, problem: &Problem, simpler: &Fit) -> Vec<Vec<f64>> {
    let value = |name: &str| {
        let at = simpler.problem.parameters.iter().position(|p| p.name == name)?;
        Some(simpler.theta[at])
    };
    let start = |time_s: f64| {
        let one = |p: &Parameter| {
            let new = match p.target {
                Target::Effect(..) => time_s,
                Target::Entry(..) => vehicle.free_value(&p.target),
            };
            let most =
                if matches!(p.target, Target::Entry(Matrix::A, ..)) { p.upper.min(0.0) } else { p.upper };
            value(&p.name).unwrap_or(new).clamp(p.lower, most)
        };
        problem.parameters.iter().map(one).collect()
    };
    START_DELAYS_S.iter().map(|s| start(*s)).collect()
}
