//! Output error: the free-running simulation compared with the record, output by output, with white or
//! autoregressive residuals.
//!
//! The variances of the outputs are concentrated out of the likelihood: the cost is the sum over outputs of
//! weight N / 2 ln(mean square of the whitened residual). Unknowns of one segment (initial state, offsets)
//! enter linearly and are eliminated exactly (variable projection; Golub and Pereyra 1973), so that a step
//! moves the parameters with the nuisances always at their optimum.

use super::sweep::simulation;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_linalg::spectral_abscissa;

use super::ar::Ar;
use super::data::Segment;
use super::normal::pseudo_inverse;
use super::problem::Problem;
use super::sums::{OutputSums, spacing, sums};

/// The cost and its derivatives at one value of the parameters.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// Values of the parameters, SI.
    pub theta: Vec<f64>,
    /// Nuisances of every segment at the minimum of the cost.
    pub nuisances: Vec<Vec<f64>>,
    /// Concentrated negative log-likelihood, without constants.
    pub cost: f64,
    /// Mean square of the whitened residual of every output; 0 for outputs without weight.
    pub variances: Vec<f64>,
    /// Number of whitened residuals of every output.
    pub counts: Vec<usize>,
    /// Information about the parameters, parameters x parameters, with the nuisances eliminated.
    pub information: DMatrix<f64>,
    /// Negative gradient of the cost by the parameters.
    pub right: DVector<f64>,
    /// Derivative of every segment's optimal nuisances by the parameters, nuisances x parameters.
    pub coupling: Vec<DMatrix<f64>>,
}

/// Evaluates the cost at `theta`; the residuals of output i are filtered by `whitening[i]`. `None` when the
/// simulation diverges.
pub fn evaluate(
    problem: &Problem,
    segments: &[Segment],
    whitening: &[Ar],
    theta: &[f64],
    nuisances: &[Vec<f64>],
) -> Option<Evaluation> {
    if grows(problem, segments, theta) {
        return None;
    }
    let simulation = simulation(problem, theta)?;
    let all: Vec<OutputSums> = segments
        .par_iter()
        .zip(nuisances)
        .map(|(segment, nuisance)| sums(problem, &*simulation, segment, whitening, nuisance))
        .collect::<Option<_>>()?;
    combine(problem, &all, theta, nuisances)
}

/// Largest exponent by which the fastest unstable mode may grow over a segment: beyond it, the free run
/// depends more on the initial state's last digits than on the model.
const LARGEST_GROWTH: f64 = 5.0;

fn grows(problem: &Problem, segments: &[Segment], theta: &[f64]) -> bool {
    let longest = segments.iter().map(|s| s.steps).max().unwrap_or(0) as f64 * problem.period_s;
    // A free run is as useless for a model whose poles cannot be computed.
    spectral_abscissa(&problem.matrices_at(theta)[0]).map_or(true, |rate| rate * longest >= LARGEST_GROWTH)
}

fn combine(
    problem: &Problem,
    all: &[OutputSums],
    theta: &[f64],
    nuisances: &[Vec<f64>],
) -> Option<Evaluation> {
    let (np, p) = (theta.len(), problem.p());
    let counts: Vec<usize> =
        (0..p).map(|i| all.iter().filter_map(|s| s[i].as_ref()).map(|s| s.rows).sum()).collect();
    let total = |steps: &[DVector<f64>], i: usize| -> f64 {
        all.iter().zip(steps).filter_map(|(s, step)| Some(s[i].as_ref()?.square_after(step))).sum()
    };
    let width = np + problem.nuisances();
    let mut steps = vec![DVector::zeros(width); all.len()];
    let mut variances: Vec<f64> = (0..p).map(|i| floor(total(&steps, i) / counts[i].max(1) as f64)).collect();
    let mut result = None;
    // The optimal nuisances depend on the variances and vice versa; the iteration converges at once.
    for _ in 0..3 {
        let mut information = DMatrix::zeros(np, np);
        let mut right = DVector::zeros(np);
        let mut coupling = Vec::with_capacity(all.len());
        for (segment, step) in all.iter().zip(&mut steps) {
            let (mut f, mut g) = (DMatrix::zeros(width, width), DVector::zeros(width));
            for (i, sums) in segment.iter().enumerate() {
                if let Some(sums) = sums {
                    let weight = problem.weights[i] / variances[i];
                    f += &sums.information * weight;
                    g.axpy(weight, &sums.right, 1.0);
                }
            }
            let reduced = eliminate(&f, &g, np)?;
            information += &reduced.information;
            right += &reduced.right;
            step.rows_mut(np, width - np).copy_from(&reduced.step);
            coupling.push(reduced.coupling);
        }
        variances = (0..p).map(|i| floor(total(&steps, i) / counts[i].max(1) as f64)).collect();
        result = Some((information, right, coupling));
    }
    let (information, right, coupling) = result?;
    let cost = (0..p)
        .filter(|i| counts[*i] > 0)
        .map(|i| 0.5 * problem.weights[i] * counts[i] as f64 * variances[i].ln())
        .sum();
    let nuisances = nuisances
        .iter()
        .zip(&steps)
        .map(|(old, step)| old.iter().zip(step.rows(np, width - np).iter()).map(|(a, b)| a + b).collect())
        .collect();
    Some(Evaluation {
        theta: theta.to_vec(),
        nuisances,
        cost,
        variances,
        counts,
        information,
        right,
        coupling,
    })
}

/// A residual of exactly zero would make the cost infinite.
fn floor(variance: f64) -> f64 {
    variance.max(1e-30)
}

/// Normal equations of the parameters after elimination of the nuisances.
pub struct Reduced {
    /// Information about the parameters, F - B D^-1 B'.
    pub information: DMatrix<f64>,
    /// Right-hand side of the parameters, g - B D^-1 d.
    pub right: DVector<f64>,
    /// Step of the nuisances at fixed parameters.
    pub step: DVector<f64>,
    /// Derivative of the optimal nuisances by the parameters, -D^-1 B'.
    pub coupling: DMatrix<f64>,
}

/// Eliminates the unknowns from index `np` on from the normal equations F x = g.
pub fn eliminate(f: &DMatrix<f64>, g: &DVector<f64>, np: usize) -> Option<Reduced> {
    let rest = f.nrows() - np;
    let inverse = pseudo_inverse(&f.view((np, np), (rest, rest)).into_owned())?;
    let b = f.view((0, np), (np, rest));
    let d = g.rows(np, rest);
    let coupling = -&inverse * b.transpose();
    Some(Reduced {
        information: f.view((0, 0), (np, np)) + b * &coupling,
        right: g.rows(0, np) + coupling.transpose() * d,
        step: &inverse * d,
        coupling,
    })
}

/// Residuals of every output as runs without gaps, at the given parameters and nuisances.
pub fn residual_runs(
    problem: &Problem,
    segments: &[Segment],
    theta: &[f64],
    nuisances: &[Vec<f64>],
) -> Option<Vec<Vec<Vec<f64>>>> {
    let p = problem.p();
    let simulated = simulate(problem, segments, theta, nuisances)?;
    let mut runs: Vec<Vec<Vec<f64>>> = vec![Vec::new(); p];
    for (segment, outputs) in segments.iter().zip(&simulated) {
        for (i, runs) in runs.iter_mut().enumerate() {
            let every = spacing(segment, i, p);
            let mut last = None;
            for k in 0..segment.steps {
                let residual = segment.outputs[k * p + i] - outputs[k * p + i];
                if residual.is_finite() {
                    if last.is_none_or(|l| k - l != every) {
                        runs.push(Vec::new());
                    }
                    last = Some(k);
                    if let Some(run) = runs.last_mut() {
                        run.push(residual);
                    }
                }
            }
        }
    }
    Some(runs)
}

/// Free-running simulations of all segments, SI: steps x outputs each, row after row; `None` when one diverges.
pub fn simulate(
    problem: &Problem,
    segments: &[Segment],
    theta: &[f64],
    nuisances: &[Vec<f64>],
) -> Option<Vec<Vec<f64>>> {
    // Without free parameters a sweep is a plain simulation.
    let mut fixed = problem.clone();
    fixed.vehicle = problem.vehicle_at(theta);
    fixed.parameters.clear();
    let simulation = simulation(&fixed, &[])?;
    segments
        .iter()
        .zip(nuisances)
        .map(|(segment, nuisance)| {
            let mut outputs = Vec::with_capacity(segment.outputs.len());
            let fine = simulation.sweep(segment, nuisance, &mut |s| outputs.extend_from_slice(s.predicted));
            fine.then_some(outputs)
        })
        .collect()
}
