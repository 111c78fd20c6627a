//! The Kalman predictor of a linear model: gains, innovation covariances, and their derivatives.
//!
//! Process noise acts on the states that have dynamics of their own, measurement noise on every output; both white,
//! of unknown size (the filter-error method of flight identification; Jategaonkar, Flight Vehicle System
//! Identification, AIAA 2015, chapter 5). The steady state of the filter is used; where sensors deliver at different
//! rates, its periodic steady state, one gain a phase.

use nalgebra::DMatrix;
use rayon::prelude::*;
use whirlstand_vehicle::{Target, discretise};

use super::data::Segment;
use super::problem::Problem;

/// Longest pattern of fresh and stale outputs that is treated as periodic, steps.
const LONGEST_PATTERN: usize = 64;
/// Steps after which a filter that has not settled is taken as it is.
const MOST_STEPS: usize = 4000;

/// When each output is fresh: every so many steps, from a first one on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// Steps from one fresh value to the next, and the first fresh step; 0 steps for an output that never is.
    outputs: Vec<(usize, usize)>,
    length: usize,
}

impl Pattern {
    /// The pattern of a segment; outputs that it does not have are never fresh.
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

/// Which noises there are: states that are driven, outputs that are measured.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoiseStructure {
    /// States with process noise.
    pub states: Vec<usize>,
    /// Outputs with measurement noise.
    pub outputs: Vec<usize>,
}

impl NoiseStructure {
    /// Process noise on every state whose row of A or B has a free or a non-kinematic entry.
    pub fn new(problem: &Problem) -> Self {
        let vehicle = &problem.vehicle;
        let free =
            |i: usize| vehicle.free.iter().any(|f| matches!(f.target, Target::Entry(_, r, _) if r == i));
        let kinematic = |i: usize| {
            let a = vehicle.a.row(i);
            a.iter().filter(|v| **v != 0.0).count() == 1 && vehicle.b.row(i).iter().all(|v| *v == 0.0)
        };
        Self {
            states: (0..problem.n()).filter(|i| free(*i) || !kinematic(*i)).collect(),
            outputs: (0..problem.p()).filter(|i| problem.weights[*i] > 0.0).collect(),
        }
    }
}

/// One phase of the periodic steady state.
#[derive(Debug, Clone)]
pub struct Phase {
    /// Outputs that are fresh.
    pub fresh: Vec<usize>,
    /// Gain, states x fresh outputs.
    pub gain: DMatrix<f64>,
    /// Covariance of the innovations of the fresh outputs.
    pub covariance: DMatrix<f64>,
    /// Derivative of the gain by the parameters: (state, fresh output) x parameters, row after row.
    pub gain_slopes: Vec<f64>,
    /// Derivatives of the covariance by the parameters.
    pub covariance_slopes: Vec<DMatrix<f64>>,
}

/// The predictor at one value of all parameters.
#[derive(Debug, Clone)]
pub struct Gains {
    /// How many parameters the noise model has.
    pub noise_parameters: usize,
    parameters: usize,
    phases: Vec<Phase>,
}

impl Gains {
    /// Gains at `theta` and the noise parameters `noise`, with derivatives by all of them if `slopes`.
    pub fn new(
        problem: &Problem,
        structure: &NoiseStructure,
        pattern: &Pattern,
        theta: &[f64],
        noise: &[f64],
        slopes: bool,
    ) -> Option<Self> {
        let (mut phases, centre) = phases(problem, structure, pattern, theta, noise, None)?;
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
                    // From the centre's steady state the way is short, and the difference needs few digits of it.
                    let near = Some((&centre[..], 1e-4 * step.min(1e-3)));
                    let (theta, noise) = moved.split_at(theta.len());
                    Some(self::phases(problem, structure, pattern, theta, noise, near)?.0)
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

    /// Number of phases.
    pub fn phases(&self) -> usize {
        self.phases.len()
    }

    /// The phase of step `k`.
    pub fn phase(&self, k: usize) -> &Phase {
        &self.phases[k % self.phases.len()]
    }

    /// K e, the change of the state by the innovations of step `k`. With `moved`, a parameter and how far it lies from
    /// where the gains were computed, K is that of the neighbour, to first order.
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

    /// Adds K e to the state and the derivative of that to its sensitivities.
    #[expect(clippy::too_many_arguments, reason = "the inner step of one loop")]
    pub fn correct(
        &self,
        k: usize,
        measured: &[f64],
        predicted: &[f64],
        slopes: &[f64],
        columns: usize,
        x: &mut [f64],
        s: &mut [f64],
        q: usize,
    ) {
        let phase = self.phase(k);
        let fresh = phase.fresh.len();
        for (column, &output) in phase.fresh.iter().enumerate() {
            let error = measured[output] - predicted[output];
            if !error.is_finite() {
                continue;
            }
            let slope = &slopes[output * columns..(output + 1) * columns];
            for (i, x) in x.iter_mut().enumerate() {
                let gain = phase.gain[(i, column)];
                *x += gain * error;
                let row = &mut s[i * q..i * q + columns];
                row.iter_mut().zip(slope).for_each(|(s, d)| *s -= gain * d);
                if !phase.gain_slopes.is_empty() {
                    let own = &phase.gain_slopes[(i * fresh + column) * self.parameters..][..self.parameters];
                    row.iter_mut().zip(own).for_each(|(s, d)| *s += error * d);
                }
            }
        }
    }
}

/// The linear model and its noises, unpacked for the covariance recursion.
struct Recursion {
    n: usize,
    /// Transition matrix, row after row.
    phi: Vec<f64>,
    /// Process noise of a step on every state.
    driving: Vec<f64>,
    /// For every phase the fresh outputs: row of C and variance.
    fresh: Vec<Vec<(Vec<f64>, f64)>>,
    covariance: Vec<f64>,
    scratch: Vec<f64>,
}

impl Recursion {
    /// Once through all phases. Independent measurements are taken in one after the other, which is the same as all
    /// at once and needs no factorisation.
    fn pass(&mut self) {
        let n = self.n;
        for fresh in &self.fresh {
            let p = &mut self.covariance;
            for (c, variance) in fresh {
                let pc = &mut self.scratch[..n];
                pc.fill(0.0);
                for (j, c) in c.iter().enumerate().filter(|(_, c)| **c != 0.0) {
                    (0..n).for_each(|i| pc[i] += c * p[i * n + j]);
                }
                let s: f64 = variance + c.iter().zip(&*pc).map(|(c, v)| c * v).sum::<f64>();
                for i in 0..n {
                    let f = pc[i] / s;
                    (0..n).for_each(|j| p[i * n + j] -= f * pc[j]);
                }
            }
            propagate(&self.phi, p, &mut self.scratch, n);
            (0..n).for_each(|i| p[i * n + i] += self.driving[i]);
        }
    }
}

/// P becomes phi P phi', made symmetric.
fn propagate(phi: &[f64], p: &mut [f64], scratch: &mut [f64], n: usize) {
    for i in 0..n {
        let row = &mut scratch[i * n..(i + 1) * n];
        row.fill(0.0);
        for (k, f) in phi[i * n..(i + 1) * n].iter().enumerate() {
            row.iter_mut().zip(&p[k * n..(k + 1) * n]).for_each(|(r, p)| *r += f * p);
        }
    }
    for i in 0..n {
        for j in 0..=i {
            let v: f64 =
                scratch[i * n..(i + 1) * n].iter().zip(&phi[j * n..(j + 1) * n]).map(|(a, b)| a * b).sum();
            p[i * n + j] = v;
            p[j * n + i] = v;
        }
    }
}

/// The periodic steady state: the covariance recursion, run until a whole pattern changes it by less than
/// `tolerance`, from `start` if one is known. Gives the phases and the covariance before the first.
fn phases(
    problem: &Problem,
    structure: &NoiseStructure,
    pattern: &Pattern,
    theta: &[f64],
    noise: &[f64],
    start: Option<(&[f64], f64)>,
) -> Option<(Vec<Phase>, Vec<f64>)> {
    let n = problem.n();
    let vehicle = problem.vehicle_at(theta);
    let (phi, _) = discretise(&vehicle.a, &vehicle.b, problem.period_s).ok()?;
    let (driving, measuring) = noise.split_at(structure.states.len());
    let mut q = vec![0.0; n];
    for (&state, log) in structure.states.iter().zip(driving) {
        q[state] = (2.0 * log).exp() * problem.period_s;
    }
    let variance = |output: usize| {
        let at = structure.outputs.iter().position(|o| *o == output);
        at.map_or(1.0, |at| (2.0 * measuring[at]).exp())
    };
    let outputs = |phase: usize| -> Vec<usize> {
        structure.outputs.iter().copied().filter(|o| pattern.expects(phase, *o)).collect()
    };
    let mut covariance = vec![0.0; n * n];
    let tolerance = match start {
        Some((known, tolerance)) => {
            covariance.copy_from_slice(known);
            tolerance
        }
        None => {
            (0..n).for_each(|i| covariance[i * n + i] = q[i] / problem.period_s.max(1e-9) + 1e-12);
            1e-10
        }
    };
    let mut recursion = Recursion {
        n,
        phi: (0..n * n).map(|at| phi[(at / n, at % n)]).collect(),
        driving: q,
        fresh: (0..pattern.length)
            .map(|f| {
                let row = |o: usize| (vehicle.c.row(o).iter().copied().collect(), variance(o));
                outputs(f).into_iter().map(row).collect()
            })
            .collect(),
        covariance,
        scratch: vec![0.0; n * n],
    };
    let mut steps = 0;
    loop {
        let before = recursion.covariance.clone();
        recursion.pass();
        steps += pattern.length;
        let now = &recursion.covariance;
        if !now.iter().all(|v| v.is_finite()) {
            return None;
        }
        let change = (0..n)
            .map(|i| (now[i * n + i] - before[i * n + i]).abs() / now[i * n + i].abs().max(1e-300))
            .fold(0.0, f64::max);
        if change < tolerance || steps >= MOST_STEPS {
            break;
        }
    }
    let first = recursion.covariance.clone();
    let mut p = DMatrix::from_row_slice(n, n, &first);
    let q = DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&recursion.driving));
    let mut result = Vec::with_capacity(pattern.length);
    for phase in 0..pattern.length {
        let fresh = outputs(phase);
        let c = DMatrix::from_fn(fresh.len(), n, |i, j| vehicle.c[(fresh[i], j)]);
        let cp = &c * &p;
        let mut s = &cp * c.transpose();
        for (i, output) in fresh.iter().enumerate() {
            s[(i, i)] += variance(*output);
        }
        let gain = if fresh.is_empty() {
            DMatrix::zeros(n, 0)
        } else {
            s.clone().cholesky()?.solve(&cp).transpose()
        };
        p = &phi * (&p - &gain * &cp) * phi.transpose() + &q;
        result.push(Phase {
            fresh,
            gain: &phi * gain,
            covariance: s,
            gain_slopes: Vec::new(),
            covariance_slopes: Vec::new(),
        });
    }
    Some((result, first))
}
