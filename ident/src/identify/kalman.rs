//! Prediction-error search with a Kalman filter: start values, then the optimum.

use nalgebra::{DMatrix, DVector};

use super::data::Segment;
use super::fitted::{Fit, NoiseFit, bounds, no_nuisances};
use super::predictor::NoiseStructure;
use super::problem::Problem;
use super::search::{Limits, descends, search};
use super::{filter_error, spread, start};
use crate::watch::Watch;

/// The start with the best short predictions: an equation-error fit is enough, since the filter follows the record.
pub fn kalman_start(problem: &Problem, segments: &[Segment], extra: &[Vec<f64>], watch: &Watch) -> Vec<f64> {
    let structure = NoiseStructure::new(problem);
    let noise = first_noise(problem, segments, &structure);
    let nuisances = no_nuisances(problem, segments);
    let mut starts = extra.to_vec();
    starts.extend(start::candidates(problem, segments));
    starts.push(start::given(problem));
    let cost = |theta: &Vec<f64>| {
        let unknowns: Vec<f64> = theta.iter().chain(&noise).copied().collect();
        filter_error::evaluate(problem, &structure, segments, &unknowns, &nuisances)
            .map_or(f64::INFINITY, |e| e.cost)
    };
    let (mut best, mut least) = (0, f64::INFINITY);
    for (i, start) in starts.iter().enumerate() {
        let cost = cost(start);
        if cost < least {
            (best, least) = (i, cost);
        }
        if watch.is_stopped() && least.is_finite() {
            break;
        }
    }
    starts.swap_remove(best)
}

/// Noise at the start: measurement noise as the record shows it, process noise that follows it within a few steps.
fn first_noise(problem: &Problem, segments: &[Segment], structure: &NoiseStructure) -> Vec<f64> {
    let p = problem.p();
    let measured: Vec<f64> = structure
        .outputs
        .iter()
        .map(|&i| {
            let values: Vec<f64> =
                segments.iter().flat_map(|s| s.output(i, p)).filter(|v| v.is_finite()).collect();
            let mean = whirlstand_logs::stats::mean(&values);
            let spread = whirlstand_logs::stats::rms(&values.iter().map(|v| v - mean).collect::<Vec<_>>());
            whirlstand_logs::stats::white_noise_std(&values).max(1e-4 * spread).max(1e-12)
        })
        .collect();
    let driven = structure.states.iter().map(|&j| {
        let at = structure.outputs.iter().position(|&i| problem.vehicle.c[(i, j)] != 0.0);
        let size = match at {
            Some(at) => measured[at] / problem.vehicle.c[(structure.outputs[at], j)].abs(),
            None => whirlstand_logs::stats::mean(&measured),
        };
        (0.3 * size / problem.period_s.sqrt()).ln()
    });
    driven.chain(measured.iter().map(|s| s.ln())).collect()
}

/// Fits the parameters and the noises by maximum likelihood of the Kalman filter's innovations.
pub fn kalman(
    problem: &Problem,
    segments: &[Segment],
    theta: &[f64],
    watch: &Watch,
) -> Option<(Fit, DMatrix<f64>)> {
    let structure = NoiseStructure::new(problem);
    let noise = first_noise(problem, segments, &structure);
    let np = theta.len();
    let mut limits = bounds(problem);
    // From a millionth of the start, where a noise no longer acts, to a thousand times it.
    limits.extend(noise.iter().map(|v| (v - 14.0, v + 7.0)));
    let unknowns: Vec<f64> = theta.iter().chain(&noise).copied().collect();
    let first =
        filter_error::evaluate(problem, &structure, segments, &unknowns, &no_nuisances(problem, segments))?;
    // Again from the best initial states: before, their transients pass for innovations and turn the gradient.
    let first = filter_error::evaluate(problem, &structure, segments, &unknowns, &first.nuisances)?;
    let at = |from: &filter_error::Evaluation, unknowns: &[f64], step: &DVector<f64>| {
        let follow = |(old, coupling): (&Vec<f64>, &DMatrix<f64>)| -> Vec<f64> {
            let moved = coupling * step;
            old.iter().zip(moved.iter()).map(|(a, b)| a + b).collect()
        };
        let nuisances: Vec<Vec<f64>> = from.nuisances.iter().zip(&from.coupling).map(follow).collect();
        filter_error::evaluate(problem, &structure, segments, unknowns, &nuisances)
    };
    let search_limits = Limits { iterations: 60, tolerance: 0.01, ..Limits::default() };
    let (found, outcome) =
        search(first, &limits, search_limits, at, |step, cost| descends(watch, step, cost));
    let information = spread::marginal(&found.information, np)?;
    let covariance = super::normal::pseudo_inverse(&information)?;
    let fit = Fit {
        problem: problem.clone(),
        theta: found.unknowns[..np].to_vec(),
        nuisances: found.nuisances,
        covariance,
        fixed: Vec::new(),
        noise: NoiseFit::Kalman(structure, found.unknowns[np..].to_vec()),
        cost: found.cost,
        outcome,
    };
    Some((fit, information))
}
