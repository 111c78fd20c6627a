//! Kalman predictor of a linear model: gains, innovation covariances, and their derivatives.
//!
//! Process noise acts on the states that have dynamics of their own, measurement noise on every output; both
//! are white and of unknown variance (the filter-error method of flight identification; Jategaonkar, Flight
//! Vehicle System Identification, AIAA 2015, chapter 5). The steady state of the filter is used; with sensors
//! of different rates, its periodic steady state with one gain per phase.

use multiversion::multiversion;
use nalgebra::DMatrix;
use rayon::prelude::*;
use whirlstand_control::{FilterModel, settled_covariance};
use whirlstand_vehicle::discretise;

use super::data::Segment;
use super::problem::{Problem, Step};

/// Longest pattern of fresh and stale outputs that is treated as periodic, steps.
const LONGEST_PATTERN: usize = 64;

/// Sampling pattern of the outputs: for each the steps between fresh values, and its first fresh step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// Steps from one fresh value to the next, and the first fresh step; 0 steps for an output that is never
    /// fresh.
    outputs: Vec<(usize, usize)>,
    length: usize,
}

impl Pattern {
    /// The sampling pattern of a segment; outputs that it does not have are never fresh.
    pub fn of(segment: &Segment, p: usize) -> Self {
        let outputs: Vec<(usize, usize)> = (0..p)
            .map(|i| {
                let fresh: Vec<usize> =
                    (0..segment.steps).filter(|k| segment.outputs[k * p + i].is_finite()).collect();
                let mut gaps: Vec<usize> = fresh.windows(2).map(|w| w[1] - w[0]).collect();
                gaps.sort_unstable();
                let every = gaps.get(gaps.len() / 2).copied().unwrap_or(0);
                (every, fresh.first().map_or(0, |f| f % every.max(1)))
            })
            .collect();
        let rates = outputs.iter().map(|(every, _)| *every).filter(|e| *e > 0);
        let length = rates.fold(1, |l, e| l / gcd(l, e) * e);
        if length > LONGEST_PATTERN {
            return Self {
                outputs: outputs.iter().map(|(e, _)| (usize::from(*e > 0), 0)).collect(),
                length: 1,
            };
        }
        Self { outputs, length }
    }

    fn expects(&self, phase: usize, output: usize) -> bool {
        let (every, first) = self.outputs[output];
        every > 0 && phase % every == first
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// A force that wanders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Force {
    /// Index of the state in whose equation it acts.
    pub on: usize,
    /// Index of an output that shows it.
    pub output: usize,
}

/// Structure of the noise: states with process noise, and outputs with measurement noise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoiseStructure {
    /// Indices of the states with process noise.
    pub states: Vec<usize>,
    /// Indices of the outputs with measurement noise.
    pub outputs: Vec<usize>,
    /// Wandering forces, which are states of the predictor after those of the vehicle, with process noise of their own.
    pub forces: Vec<Force>,
}

impl NoiseStructure {
    /// Process noise on every state whose row of A and B is dynamics and not a definition.
    pub fn new(problem: &Problem) -> Self {
        let vehicle = &problem.vehicle;
        Self {
            states: (0..problem.n()).filter(|i| vehicle.kinematic_row(*i).is_none()).collect(),
            outputs: (0..problem.p()).filter(|i| problem.weights[*i] > 0.0).collect(),
            forces: Vec::new(),
        }
    }

    /// As [`new`](Self::new), with wandering forces.
    pub fn with_forces(problem: &Problem, forces: Vec<Force>) -> Self {
        let mut structure = Self::new(problem);
        structure.states.extend((0..forces.len()).map(|k| problem.n() + k));
        Self { forces, ..structure }
    }
}

/// One phase of the periodic steady state.
#[derive(Debug, Clone)]
pub struct Phase {
    /// Indices of the outputs that are fresh.
    pub fresh: Vec<usize>,
    /// Gain, states x fresh outputs.
    pub gain: DMatrix<f64>,
    /// Covariance of the innovations, fresh outputs x fresh outputs, SI.
    pub covariance: DMatrix<f64>,
    /// Derivative of the gain by the parameters: (state, fresh output) x parameters, row after row.
    pub gain_slopes: Vec<f64>,
    /// Derivatives of the covariance, one matrix per parameter.
    pub covariance_slopes: Vec<DMatrix<f64>>,
}

/// The predictor at one value of all parameters.
#[derive(Debug, Clone)]
pub struct Gains {
    /// Number of noise parameters.
    pub noise_parameters: usize,
    parameters: usize,
    phases: Vec<Phase>,
}

impl Gains {
    /// Gains at `theta` and the noise parameters `noise`; with derivatives by all of them if `slopes`.
    pub fn new(
        problem: &Problem,
        structure: &NoiseStructure,
        pattern: &Pattern,
        theta: &[f64],
        noise: &[f64],
        slopes: bool,
    ) -> Option<Self> {
        let mut phases = phases(problem, structure, pattern, theta, noise)?;
        let parameters = theta.len() + noise.len();
        if slopes {
            let all: Vec<f64> = theta.iter().chain(noise).copied().collect();
            let moved = (0..parameters).into_par_iter().map(|i| {
                let step = match problem.parameters.get(i) {
                    Some(p) => 1e-4 * theta[i].abs().max(1e-3 * (p.upper - p.lower)),
                    None => 1e-3,
                };
                let at = |sign: f64| {
                    let mut moved = all.clone();
                    moved[i] += sign * step;
                    let (theta, noise) = moved.split_at(theta.len());
                    self::phases(problem, structure, pattern, theta, noise)
                };
                Some((at(1.0)?, at(-1.0)?, 0.5 / step))
            });
            let moved: Vec<_> = moved.collect::<Option<_>>()?;
            for (f, phase) in phases.iter_mut().enumerate() {
                let entries = phase.gain.len();
                phase.gain_slopes = vec![0.0; entries * parameters];
                for (i, (above, below, inverse)) in moved.iter().enumerate() {
                    let difference = (&above[f].gain - &below[f].gain) * *inverse;
                    for row in 0..difference.nrows() {
                        for column in 0..difference.ncols() {
                            let at = (row * difference.ncols() + column) * parameters + i;
                            phase.gain_slopes[at] = difference[(row, column)];
                        }
                    }
                    phase.covariance_slopes.push((&above[f].covariance - &below[f].covariance) * *inverse);
                }
            }
        }
        Some(Self { noise_parameters: noise.len(), parameters, phases })
    }

    /// Number of phases of the periodic steady state.
    pub fn phases(&self) -> usize {
        self.phases.len()
    }

    /// The phase of step `k`.
    pub fn phase(&self, k: usize) -> &Phase {
        &self.phases[k % self.phases.len()]
    }

    /// Writes K e, the correction of the state by the innovations of step `k`, into `out`. With `moved`, a
    /// parameter and its distance from the value at which the gains were computed, K is corrected for that
    /// distance to first order.
    pub fn change(
        &self,
        k: usize,
        measured: &[f64],
        predicted: &[f64],
        moved: Option<(usize, f64)>,
        out: &mut [f64],
    ) {
        let phase = self.phase(k);
        let fresh = phase.fresh.len();
        out.fill(0.0);
        for (column, &output) in phase.fresh.iter().enumerate() {
            let error = measured[output] - predicted[output];
            if !error.is_finite() {
                continue;
            }
            for (i, x) in out.iter_mut().enumerate() {
                let slope = match moved {
                    Some((parameter, by)) if !phase.gain_slopes.is_empty() => {
                        by * phase.gain_slopes[(i * fresh + column) * self.parameters + parameter]
                    }
                    _ => 0.0,
                };
                *x += (phase.gain[(i, column)] + slope) * error;
            }
        }
    }

    /// Adds K e to the state `x` and its derivative to the sensitivities `s`, whose rows have `q` columns.
    pub fn correct(&self, step: &Step<'_>, measured: &[f64], x: &mut [f64], s: &mut [f64], q: usize) {
        correct(self.phase(step.k), self.parameters, step, measured, x, s, q);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn correct(
    phase: &Phase,
    parameters: usize,
    step: &Step<'_>,
    measured: &[f64],
    x: &mut [f64],
    s: &mut [f64],
    q: usize,
) {
    let fresh = phase.fresh.len();
    for (column, &output) in phase.fresh.iter().enumerate() {
        let error = measured[output] - step.predicted[output];
        if !error.is_finite() {
            continue;
        }
        let slope = step.slopes(output);
        for (i, x) in x.iter_mut().enumerate() {
            let gain = phase.gain[(i, column)];
            *x += gain * error;
            let row = &mut s[i * q..][..slope.len()];
            // An axis that shares nothing with the output's has no gain.
            if gain != 0.0 {
                row.iter_mut().zip(slope).for_each(|(s, d)| *s -= gain * d);
            }
            if !phase.gain_slopes.is_empty() {
                let own = &phase.gain_slopes[(i * fresh + column) * parameters..][..parameters];
                row.iter_mut().zip(own).for_each(|(s, d)| *s += error * d);
            }
        }
    }
}

/// The phases of the filter's periodic steady state.
fn phases(
    problem: &Problem,
    structure: &NoiseStructure,
    pattern: &Pattern,
    theta: &[f64],
    noise: &[f64],
) -> Option<Vec<Phase>> {
    let n = problem.n();
    let vehicle = problem.vehicle_at(theta);
    let (phi, g) = discretise(&vehicle.a, &vehicle.b, problem.period_s).ok()?;
    let (driving, measuring) = noise.split_at(structure.states.len());
    let mut q = DMatrix::zeros(n, n);
    for (&state, log) in structure.states.iter().zip(driving) {
        q[(state, state)] = (2.0 * log).exp() * problem.period_s;
    }
    let fresh = fresh_outputs(structure, pattern, measuring);
    let mut variance = vec![1.0; problem.p()];
    for (&output, log) in structure.outputs.iter().zip(measuring) {
        variance[output] = (2.0 * log).exp();
    }
    let mask = |outputs: &Vec<(usize, f64)>| outputs.iter().fold(0, |mask, (output, _)| mask | 1 << output);
    let masks: Vec<u64> = fresh.iter().map(mask).collect();
    let model = FilterModel { f: phi, g, h: vehicle.c.clone(), d: vehicle.d.clone(), q, variance };
    let settled = settled_covariance(&model, &masks)?;
    steady_gains(&model, settled, &fresh)
}

/// Fresh outputs of every phase of the pattern, each with the variance of its measurement noise from
/// `measuring`, the logarithms of the standard deviations.
fn fresh_outputs(structure: &NoiseStructure, pattern: &Pattern, measuring: &[f64]) -> Vec<Vec<(usize, f64)>> {
    let fresh = |phase: usize| {
        let outputs = structure.outputs.iter().zip(measuring);
        outputs
            .filter(|(output, _)| pattern.expects(phase, **output))
            .map(|(output, log)| (*output, (2.0 * log).exp()))
            .collect()
    };
    (0..pattern.length).map(fresh).collect()
}

/// Gain and innovation covariance of every phase, by one pass through the pattern from the settled
/// covariance.
fn steady_gains(
    model: &FilterModel,
    settled: DMatrix<f64>,
    fresh: &[Vec<(usize, f64)>],
) -> Option<Vec<Phase>> {
    let FilterModel { f: phi, h, q, .. } = model;
    let n = phi.nrows();
    let mut p = settled;
    let mut result = Vec::with_capacity(fresh.len());
    for fresh in fresh {
        let c = DMatrix::from_fn(fresh.len(), n, |i, j| h[(fresh[i].0, j)]);
        let cp = &c * &p;
        let mut s = &cp * c.transpose();
        for (i, (_, variance)) in fresh.iter().enumerate() {
            s[(i, i)] += variance;
        }
        let gain = if fresh.is_empty() {
            DMatrix::zeros(n, 0)
        } else {
            s.clone().cholesky()?.solve(&cp).transpose()
        };
        p = phi * (&p - &gain * &cp) * phi.transpose() + q;
        result.push(Phase {
            fresh: fresh.iter().map(|(output, _)| *output).collect(),
            gain: phi * gain,
            covariance: s,
            gain_slopes: Vec::new(),
            covariance_slopes: Vec::new(),
        });
    }
    Some(result)
}
