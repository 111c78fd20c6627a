//! Prediction-error fit: start values, search, noise model, and fixing of parameters that the data do not determine.

use nalgebra::{DMatrix, DVector};

use super::ar::Ar;
use super::data::Segment;
pub use super::fitted::{Fit, Fixed, NoiseFit, bounds, no_nuisances, white};
use super::kalman::{Start, kalman, kalman_start};
use super::output_error::{self, Evaluation};
use super::predictor::NoiseStructure;
use super::problem::{Parameter, Problem};
use super::search::{Derivatives, Limits, Outcome, Point, descends, search};
use super::spread::{self, Undetermined};
use super::{IdentifyError, start};
use crate::watch::Watch;

/// Noise model of the residuals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Noise {
    /// White on every output: the free-running simulation is fitted as closely as possible.
    White,
    /// Autoregressive on every output: maximum likelihood under coloured residuals.
    Coloured,
    /// Process and measurement noise: innovations form of the Kalman filter.
    Kalman,
}

/// Largest order of an autoregressive residual model.
const MOST_AR: usize = 30;

impl Point for Evaluation {
    fn position(&self) -> &[f64] {
        &self.theta
    }
    fn cost(&self) -> f64 {
        self.cost
    }
    fn derivatives(&mut self) -> Option<Derivatives> {
        Some(Derivatives { information: self.information.clone(), right: self.right.clone() })
    }
}

/// Moves from `theta` to the nearest minimum of the output-error cost. `None` when the simulation at `theta`
/// diverges.
pub fn output_error(
    problem: &Problem,
    segments: &[Segment],
    whitening: &[Ar],
    theta: &[f64],
    nuisances: &[Vec<f64>],
    limits: Limits,
    watch: &Watch,
) -> Option<(Evaluation, Outcome)> {
    let first = output_error::evaluate(problem, segments, whitening, theta, nuisances)?;
    let (found, outcome) = descend(problem, segments, whitening, first, limits, watch);
    Some((found, Outcome { evaluations: outcome.evaluations + 1, ..outcome }))
}

/// Moves from the evaluation `first` to the nearest minimum.
fn descend(
    problem: &Problem,
    segments: &[Segment],
    whitening: &[Ar],
    first: Evaluation,
    limits: Limits,
    watch: &Watch,
) -> (Evaluation, Outcome) {
    let at = |from: &Evaluation, theta: &[f64], step: &DVector<f64>| {
        let follow = |(old, coupling): (&Vec<f64>, &DMatrix<f64>)| -> Vec<f64> {
            let moved = coupling * step;
            old.iter().zip(moved.iter()).map(|(a, b)| a + b).collect()
        };
        let nuisances: Vec<Vec<f64>> = from.nuisances.iter().zip(&from.coupling).map(follow).collect();
        let next = output_error::evaluate(problem, segments, whitening, theta, &nuisances)?;
        next.cost.is_finite().then_some(next)
    };
    search(first, &bounds(problem), limits, at, |step, cost| descends(watch, step, cost))
}

/// The best of all starts, after a short search from each.
///
/// Where a long free run from a start is useless (it diverges, or explains little), the search uses short
/// pieces with their own initial states: first a sixteenth of the record, then longer ones (multiple
/// shooting; Ribeiro et al., On the smoothness of nonlinear system identification, Automatica 121, 2020).
///
/// # Errors
/// [`IdentifyError::UnstableStart`].
fn from_starts(
    problem: &Problem,
    segments: &[Segment],
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Result<(Evaluation, Outcome), IdentifyError> {
    let white = white(problem);
    let mut starts = extra.to_vec();
    starts.extend(start::candidates(problem, segments));
    if starts.is_empty() {
        starts.push(start::given(problem));
        starts.extend(start::scattered(problem));
    } else if problem.parameters.iter().any(|p| p.start.is_none()) {
        starts.push(start::given(problem));
    }
    let evaluated = |segments: &[Segment]| {
        let nuisances = no_nuisances(problem, segments);
        let mut all: Vec<Evaluation> = Vec::new();
        for theta in &starts {
            let found = output_error::evaluate(problem, segments, &white, theta, &nuisances);
            all.extend(found.filter(|e| e.cost.is_finite()));
            if watch.is_stopped() && !all.is_empty() {
                break;
            }
        }
        all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        all.dedup_by(|a, b| a.cost == b.cost);
        all
    };
    let mut spent = Outcome { evaluations: starts.len(), ..Outcome::default() };
    let mut best: Option<Evaluation> = None;
    let limits = Limits { iterations: 30, ..Limits::default() };
    for first in evaluated(segments).into_iter().take(3) {
        let found = descend(problem, segments, &white, first, limits, watch);
        let converged = keep(&mut best, &mut spent, Some(found));
        let explained = || best.as_ref().is_some_and(|b| explains(problem, segments, b));
        if converged && explained() || watch.is_stopped() {
            break;
        }
    }
    if !best.as_ref().is_some_and(|b| watch.is_stopped() || explains(problem, segments, b)) {
        let longest = segments.iter().map(|s| s.steps).max().unwrap_or(0);
        let mut theta: Option<Vec<f64>> = None;
        for divisor in [16, 8, 4, 2, 1] {
            let pieces = super::data::pieces(segments, (longest / divisor).max(32));
            let start = match &theta {
                Some(theta) => theta.clone(),
                None => match evaluated(&pieces).into_iter().next() {
                    Some(e) => e.theta,
                    None => continue,
                },
            };
            let nuisances = no_nuisances(problem, &pieces);
            let found = output_error(problem, &pieces, &white, &start, &nuisances, limits, watch);
            if let Some((found, _)) = &found {
                theta = Some(found.theta.clone());
            }
            if divisor == 1 {
                keep(&mut best, &mut spent, found);
            }
        }
    }
    best.map(|b| (b, spent)).ok_or(IdentifyError::UnstableStart { tried: starts.len() })
}

/// Keeps the better of two results; returns whether the new one converged.
fn keep(best: &mut Option<Evaluation>, spent: &mut Outcome, found: Option<(Evaluation, Outcome)>) -> bool {
    let Some((found, outcome)) = found else { return false };
    spent.iterations += outcome.iterations;
    spent.evaluations += outcome.evaluations;
    if best.as_ref().is_none_or(|b| found.cost < b.cost) {
        *best = Some(found);
    }
    outcome.converged
}

/// True when the simulation explains at least four fifths of the variance of each fitted output.
fn explains(problem: &Problem, segments: &[Segment], e: &Evaluation) -> bool {
    let p = problem.p();
    (0..p).filter(|i| problem.weights[*i] > 0.0).all(|i| {
        let values: Vec<f64> =
            segments.iter().flat_map(|s| s.output(i, p)).filter(|v| v.is_finite()).collect();
        let mean = whirlstand_logs::stats::mean(&values);
        let variance =
            values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len().max(1) as f64;
        e.variances[i] < 0.2 * variance
    })
}

/// Fits by output error or prediction error, fixing parameters that the data do not determine. `extra` are
/// additional starts (of a genetic algorithm); without any, the data give them. A stopped search returns the
/// best result so far.
///
/// # Errors
/// [`IdentifyError::UnstableStart`].
pub fn fit(
    problem: &Problem,
    segments: &[Segment],
    noise: Noise,
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Result<Fit, IdentifyError> {
    let residuals = match noise {
        Noise::Kalman => Residuals::Filter(NoiseStructure::new(problem)),
        Noise::White | Noise::Coloured => Residuals::Outputs(noise),
    };
    fit_with(problem, segments, residuals, extra, watch)
}

/// Fits by prediction error with one structure of a filter's noise, as [`fit`] does.
///
/// # Errors
/// [`IdentifyError::UnstableStart`].
pub fn fit_beside(
    problem: &Problem,
    segments: &[Segment],
    noise: NoiseStructure,
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Result<Fit, IdentifyError> {
    fit_with(problem, segments, Residuals::Filter(noise), extra, watch)
}

/// Residuals that a fit makes small.
enum Residuals {
    /// Those of a free run, white or autoregressive.
    Outputs(Noise),
    /// Those of a filter.
    Filter(NoiseStructure),
}

/// Fits with one model of the residuals.
fn fit_with(
    problem: &Problem,
    segments: &[Segment],
    residuals: Residuals,
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Result<Fit, IdentifyError> {
    let mut problem = problem.clone();
    let mut fixed = Vec::new();
    let tried = IdentifyError::UnstableStart { tried: 1 };
    let mut spent = Outcome::default();
    let mut noises = Vec::new();
    let mut first = None;
    let mut theta = match &residuals {
        Residuals::Filter(structure) => {
            let start = kalman_start(&problem, structure, segments, extra, watch);
            noises = start.noise;
            start.theta
        }
        Residuals::Outputs(_) => {
            let (found, outcome) = from_starts(&problem, segments, extra, watch)?;
            spent = outcome;
            first.insert(found).theta.clone()
        }
    };
    loop {
        let found = match &residuals {
            Residuals::Filter(structure) => {
                let start = Start { theta: theta.clone(), noise: noises.clone() };
                kalman(&problem, structure, segments, &start, watch)
            }
            Residuals::Outputs(noise) => {
                match first.take().and_then(|first| outputs(&problem, segments, *noise, first, watch)) {
                    // A parameter that was just fixed may have left the others without a stable simulation.
                    None if !fixed.is_empty() => {
                        let (found, _) = from_starts(&problem, segments, &[theta.clone()], watch)?;
                        outputs(&problem, segments, *noise, found, watch)
                    }
                    found => found,
                }
            }
        };
        let Some((mut fit, information)) = found else { return Err(tried) };
        spent.iterations += fit.outcome.iterations;
        spent.evaluations += fit.outcome.evaluations;
        fit.outcome = Outcome { converged: fit.outcome.converged, ..spent };
        match spread::undetermined(&information, &fit.covariance, &problem.parameters) {
            Some(Undetermined { index, why }) if problem.parameters.len() > 1 && !watch.is_stopped() => {
                let parameter = problem.parameters.remove(index);
                theta = fit.theta;
                let mut nuisances = fit.nuisances;
                if let NoiseFit::Kalman(_, found) = fit.noise {
                    noises = found;
                    nuisances = no_nuisances(&problem, segments);
                }
                let from = theta.remove(index);
                let value =
                    lead(&mut problem, segments, &parameter, from, (&mut theta, &mut nuisances), watch);
                fixed.push(Fixed { parameter, value, why });
                if let Residuals::Outputs(_) = residuals {
                    first = output_error::evaluate(&problem, segments, &white(&problem), &theta, &nuisances);
                }
            }
            _ => return Ok(Fit { fixed, ..fit }),
        }
    }
}

/// Moves an undetermined parameter in steps from its fitted value to that of the vehicle file, refitting the
/// others, while the simulation stays bounded. Returns the value reached.
fn lead(
    problem: &mut Problem,
    segments: &[Segment],
    parameter: &Parameter,
    from: f64,
    (theta, nuisances): (&mut Vec<f64>, &mut Vec<Vec<f64>>),
    watch: &Watch,
) -> f64 {
    let goal = problem.vehicle.free_value(&parameter.target).clamp(parameter.lower, parameter.upper);
    let limits = Limits { iterations: 10, ..Limits::default() };
    let whites = white(problem);
    let mut reached = from;
    for share in [0.125, 0.25, 0.5, 0.75, 1.0] {
        let value = from + share * (goal - from);
        let mut moved = problem.clone();
        // The value lies within the bounds, which were checked against the effect's range.
        let set = moved.vehicle.set_free(&parameter.target, value);
        debug_assert!(set.is_ok());
        let Some((found, _)) = output_error(&moved, segments, &whites, theta, nuisances, limits, watch)
        else {
            break;
        };
        *theta = found.theta;
        *nuisances = found.nuisances;
        reached = value;
    }
    let set = problem.vehicle.set_free(&parameter.target, reached);
    debug_assert!(set.is_ok());
    reached
}

/// Fits by output error with white or autoregressive residuals, from an evaluation with white ones.
fn outputs(
    problem: &Problem,
    segments: &[Segment],
    noise: Noise,
    first: Evaluation,
    watch: &Watch,
) -> Option<(Fit, DMatrix<f64>)> {
    let mut whitening = white(problem);
    // While the noise model changes too, no round needs a precise minimum, as the next one moves it.
    let coloured = noise == Noise::Coloured;
    let limits = Limits { iterations: if coloured { 15 } else { 100 }, ..Limits::default() };
    let (mut found, mut outcome) = descend(problem, segments, &whitening, first, limits, watch);
    if coloured {
        // Noise model and parameters alternate; a few rounds converge.
        for _ in 0..20 {
            let before = found.theta.clone();
            whitening = models(problem, segments, &found)?;
            let (next, how) =
                output_error(problem, segments, &whitening, &found.theta, &found.nuisances, limits, watch)?;
            outcome.iterations += how.iterations;
            outcome.evaluations += how.evaluations;
            outcome.converged = how.converged;
            let step = DVector::from_fn(before.len(), |i, _| next.theta[i] - before[i]);
            let length = step.dot(&(&next.information * &step)).max(0.0).sqrt();
            found = next;
            if length < 0.03 || watch.is_stopped() {
                break;
            }
        }
    }
    let residual = match noise {
        Noise::White => models(problem, segments, &found)?,
        _ => whitening.iter().zip(&found.variances).map(|(_, v)| Ar::white(*v)).collect(),
    };
    let covariance = spread::covariance(problem, segments, &whitening, &residual, &found)?;
    let noise = match noise {
        Noise::White => residual,
        _ => {
            whitening.iter().zip(&found.variances).map(|(ar, v)| Ar { variance: *v, ..ar.clone() }).collect()
        }
    };
    let fit = Fit {
        problem: problem.clone(),
        theta: found.theta,
        nuisances: found.nuisances,
        covariance,
        fixed: Vec::new(),
        noise: NoiseFit::Outputs(noise),
        cost: found.cost,
        outcome,
    };
    Some((fit, found.information))
}

/// Autoregressive models of the residuals at a fit.
pub fn models(problem: &Problem, segments: &[Segment], found: &Evaluation) -> Option<Vec<Ar>> {
    let runs = output_error::residual_runs(problem, segments, &found.theta, &found.nuisances)?;
    Some(runs.iter().map(|runs| Ar::fit(runs, MOST_AR)).collect())
}
