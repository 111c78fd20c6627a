//! Prediction error in the innovations form of the Kalman filter: likelihood, gradient and Fisher
//! information.
//!
//! The unknowns are the parameters and the logarithms of the noises' standard deviations. The information is
//! that of Fisher scoring: from the sensitivities of the prediction and from those of the innovations'
//! covariance (Astrom, Maximum likelihood and prediction error methods, Automatica 16, 1980).

use super::sweep::predictor;
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::data::Segment;
use super::normal::{Normal, Sums};
use super::output_error::eliminate;
use super::predictor::{Gains, NoiseStructure, Pattern};
use super::problem::Problem;
use super::search::{Derivatives, Point};

/// The likelihood at one value of the unknowns.
#[derive(Debug, Clone)]
pub struct Evaluation {
    /// Parameters, SI, then the logarithms of the noises' standard deviations.
    pub unknowns: Vec<f64>,
    /// Nuisances of every segment at the minimum of the cost.
    pub nuisances: Vec<Vec<f64>>,
    /// Negative log-likelihood, without constants.
    pub cost: f64,
    /// Information about the unknowns, unknowns x unknowns, with the nuisances eliminated.
    pub information: DMatrix<f64>,
    /// Negative gradient of the cost by the unknowns.
    pub right: DVector<f64>,
    /// Derivative of every segment's optimal nuisances by the unknowns, nuisances x unknowns.
    pub coupling: Vec<DMatrix<f64>>,
    /// What the best nuisances gain over those of which the innovations and their derivatives are.
    pub gained: f64,
}

/// Gain of the log-likelihood by better nuisances from which on derivatives are wrong.
const NUISANCES_OFF: f64 = 0.01;

/// A point of a search for the greatest likelihood.
pub struct Likelihood<'a> {
    problem: &'a Problem,
    structure: &'a NoiseStructure,
    segments: &'a [Segment],
    /// The likelihood there.
    pub evaluation: Evaluation,
}

impl<'a> Likelihood<'a> {
    /// The point at some values of the unknowns; `None` as for [`evaluate`].
    pub fn at(
        problem: &'a Problem,
        structure: &'a NoiseStructure,
        segments: &'a [Segment],
        (unknowns, nuisances): (&[f64], &[Vec<f64>]),
    ) -> Option<Self> {
        let evaluation = evaluate(problem, structure, segments, unknowns, nuisances)?;
        Some(Self { problem, structure, segments, evaluation })
    }

    /// The point a step further; nuisances follow as far as their derivatives say.
    pub fn after(&self, unknowns: &[f64], step: &DVector<f64>) -> Option<Self> {
        let follow = |(old, coupling): (&Vec<f64>, &DMatrix<f64>)| -> Vec<f64> {
            let moved = coupling * step;
            old.iter().zip(moved.iter()).map(|(a, b)| a + b).collect()
        };
        let own = &self.evaluation;
        let nuisances: Vec<Vec<f64>> = own.nuisances.iter().zip(&own.coupling).map(follow).collect();
        Self::at(self.problem, self.structure, self.segments, (unknowns, &nuisances))
    }
}

impl Point for Likelihood<'_> {
    fn position(&self) -> &[f64] {
        &self.evaluation.unknowns
    }
    fn cost(&self) -> f64 {
        self.evaluation.cost
    }
    /// Those at the best nuisances: initial states that are off leave transients in all innovations, from which the noises
    /// seem larger than they are, and a search along such a gradient ends where it is.
    fn derivatives(&mut self) -> Option<Derivatives> {
        if self.evaluation.gained > NUISANCES_OFF {
            let Evaluation { unknowns, nuisances, .. } = &self.evaluation;
            self.evaluation = evaluate(self.problem, self.structure, self.segments, unknowns, nuisances)?;
        }
        let Evaluation { information, right, .. } = &self.evaluation;
        Some(Derivatives { information: information.clone(), right: right.clone() })
    }
}

/// Gains for every segment; equal sampling patterns share theirs.
fn gains_of(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    theta: &[f64],
    noise: &[f64],
    slopes: bool,
) -> Option<(Vec<Gains>, Vec<usize>)> {
    let mut patterns: Vec<Pattern> = Vec::new();
    let mut which = Vec::new();
    for segment in segments {
        let pattern = Pattern::of(segment, problem.p());
        let at = patterns.iter().position(|p| *p == pattern).unwrap_or_else(|| {
            patterns.push(pattern);
            patterns.len() - 1
        });
        which.push(at);
    }
    let gains = patterns.iter().map(|p| Gains::new(problem, structure, p, theta, noise, slopes));
    Some((gains.collect::<Option<_>>()?, which))
}

/// Evaluates the likelihood; `None` when the predictor has no steady state or diverges.
pub fn evaluate(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    unknowns: &[f64],
    nuisances: &[Vec<f64>],
) -> Option<Evaluation> {
    evaluated(problem, structure, segments, (unknowns, true), nuisances)
}

/// The cost alone of a problem without free parameters, at the logarithms `noise` of the noises' standard deviations and the
/// best nuisances.
pub fn cost(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    noise: &[f64],
) -> Option<f64> {
    let nuisances = super::fitted::no_nuisances(problem, segments);
    Some(evaluated(problem, structure, segments, (noise, false), &nuisances)?.cost)
}

/// Evaluates the likelihood, with its derivatives by the noises if asked.
fn evaluated(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    (unknowns, slopes): (&[f64], bool),
    nuisances: &[Vec<f64>],
) -> Option<Evaluation> {
    let np = problem.parameters.len();
    let (theta, noise) = unknowns.split_at(np);
    let (gains, which) = gains_of(problem, structure, segments, theta, noise, slopes)?;
    let parts: Vec<Part> = segments
        .par_iter()
        .zip(nuisances)
        .zip(&which)
        .map(|((segment, nuisance), w)| part(problem, &gains[*w], segment, theta, nuisance))
        .collect::<Option<_>>()?;
    let nu = unknowns.len();
    let mut evaluation = Evaluation {
        unknowns: unknowns.to_vec(),
        nuisances: Vec::with_capacity(segments.len()),
        cost: 0.0,
        information: DMatrix::zeros(nu, nu),
        right: DVector::zeros(nu),
        coupling: Vec::with_capacity(segments.len()),
        gained: 0.0,
    };
    for ((part, nuisance), w) in parts.into_iter().zip(nuisances).zip(&which) {
        let reduced = eliminate(&part.sums.information, &part.sums.right, nu)?;
        let mut step = DVector::zeros(part.sums.right.len());
        step.rows_mut(nu, reduced.step.len()).copy_from(&reduced.step);
        let square = part.sums.square_after(&step);
        evaluation.cost += 0.5 * square;
        evaluation.gained += 0.5 * (part.sums.square_after(&DVector::zeros(step.len())) - square);
        evaluation.information += &reduced.information;
        evaluation.right += &reduced.right;
        evaluation.nuisances.push(nuisance.iter().zip(reduced.step.iter()).map(|(a, b)| a + b).collect());
        evaluation.coupling.push(reduced.coupling);
        add_covariance(&mut evaluation, &gains[*w], &part)?;
    }
    // A noise that is too small to matter leaves almost no information about its logarithm, so that a Fisher
    // scoring step would be unbounded: it is limited to about a factor of e.
    for i in np..nu {
        evaluation.information[(i, i)] = evaluation.information[(i, i)].max(evaluation.right[i].abs());
    }
    evaluation.cost.is_finite().then_some(evaluation)
}

/// Normal equations of a segment under given gains, whitened by the innovations' covariance: information
/// about parameters, noises and nuisances, and the innovations as the right-hand side.
pub fn sums(problem: &Problem, gains: &Gains, segment: &Segment, theta: &[f64]) -> Option<Sums> {
    part(problem, gains, segment, theta, &vec![0.0; problem.nuisances()]).map(|part| part.sums)
}

/// Contribution of one segment.
struct Part {
    sums: Sums,
    /// Number of innovations and sum of their outer products, for every phase.
    phases: Vec<(usize, DMatrix<f64>)>,
}

fn part(
    problem: &Problem,
    gains: &Gains,
    segment: &Segment,
    theta: &[f64],
    nuisance: &[f64],
) -> Option<Part> {
    let p = problem.p();
    let model = predictor(problem, theta, gains)?;
    let columns = model.columns();
    let whiten: Vec<DMatrix<f64>> = (0..gains.phases())
        .map(|f| {
            let s = &gains.phase(f).covariance;
            let factor = s.clone().cholesky()?;
            factor.l().solve_lower_triangular(&DMatrix::identity(s.nrows(), s.nrows()))
        })
        .collect::<Option<_>>()?;
    let mut phases: Vec<(usize, DMatrix<f64>)> =
        (0..gains.phases()).map(|f| (0, DMatrix::zeros(whiten[f].nrows(), whiten[f].nrows()))).collect();
    let mut normal = Normal::new(columns);
    let mut row = vec![0.0; columns];
    let mut errors = vec![0.0; p];
    let fine = model.sweep(segment, nuisance, &mut |step| {
        let phase = gains.phase(step.k);
        let fresh = &phase.fresh;
        let measured = &segment.outputs[step.k * p..(step.k + 1) * p];
        for (e, &o) in errors.iter_mut().zip(fresh) {
            *e = measured[o] - step.predicted[o];
        }
        let errors = &errors[..fresh.len()];
        if fresh.is_empty() || errors.iter().any(|e| !e.is_finite()) {
            return;
        }
        let f = step.k % gains.phases();
        let (count, products) = &mut phases[f];
        *count += 1;
        for i in 0..fresh.len() {
            for j in 0..fresh.len() {
                products[(i, j)] += errors[i] * errors[j];
            }
            row.fill(0.0);
            let mut residual = 0.0;
            for j in 0..=i {
                let l = whiten[f][(i, j)];
                if l != 0.0 {
                    residual += l * errors[j];
                    add_scaled(&mut row, l, step.slopes(fresh[j]));
                }
            }
            normal.add(&row, residual);
        }
    });
    fine.then(|| Part { sums: normal.finish(), phases })
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_scaled(row: &mut [f64], factor: f64, other: &[f64]) {
    row.iter_mut().zip(other).for_each(|(r, s)| *r += factor * s);
}

/// Adds the determinant's part of cost and gradient, and the covariance's part of the information.
fn add_covariance(evaluation: &mut Evaluation, gains: &Gains, part: &Part) -> Option<()> {
    for (f, (count, products)) in part.phases.iter().enumerate() {
        let phase = gains.phase(f);
        if *count == 0 || phase.fresh.is_empty() {
            continue;
        }
        let n = *count as f64;
        let factor = phase.covariance.clone().cholesky()?;
        let inverse = factor.inverse();
        evaluation.cost += 0.5 * n * 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        let turned: Vec<DMatrix<f64>> = phase.covariance_slopes.iter().map(|d| &inverse * d).collect();
        let rest = DMatrix::identity(inverse.nrows(), inverse.nrows()) * n - products * &inverse;
        for (i, a) in turned.iter().enumerate() {
            // tr(S^-1 dS (N I - S^-1 E)) / 2, with the sign of the negative gradient.
            evaluation.right[i] -= 0.5 * (a * rest.transpose()).trace();
            for (j, b) in turned.iter().enumerate().take(i + 1) {
                let v = 0.5 * n * a.iter().zip(b.transpose().iter()).map(|(x, y)| x * y).sum::<f64>();
                evaluation.information[(i, j)] += v;
                if i != j {
                    evaluation.information[(j, i)] += v;
                }
            }
        }
    }
    Some(())
}

/// Predictions one step ahead over all segments: steps x outputs each.
pub fn predict(
    problem: &Problem,
    structure: &NoiseStructure,
    segments: &[Segment],
    unknowns: &[f64],
    nuisances: &[Vec<f64>],
) -> Option<Vec<Vec<f64>>> {
    let (theta, noise) = unknowns.split_at(problem.parameters.len());
    let mut fixed = problem.clone();
    fixed.vehicle = problem.vehicle_at(theta);
    fixed.parameters.clear();
    let (gains, which) = gains_of(&fixed, structure, segments, &[], noise, false)?;
    segments
        .iter()
        .zip(nuisances)
        .zip(&which)
        .map(|((segment, nuisance), w)| {
            let model = predictor(&fixed, &[], &gains[*w])?;
            let mut outputs = Vec::with_capacity(segment.outputs.len());
            let fine = model.sweep(segment, nuisance, &mut |s| outputs.extend_from_slice(s.predicted));
            fine.then_some(outputs)
        })
        .collect()
}
