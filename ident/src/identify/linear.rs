//! Simulation and one-step prediction of a linear model, with exact sensitivities.
//!
//! x+ = Phi x + Gamma u + K e, y = C x + D u + offset, e = y_measured - y (K = 0 for a simulation). The sensitivity
//! S = dx/d(theta, x0) obeys the derivative of the same recursion; dPhi and dGamma come from the Frechet derivative
//! of the matrix exponential, so that nothing is differenced. No step allocates.

use multiversion::multiversion;
use nalgebra::DMatrix;
use whirlstand_vehicle::Matrix;

use super::data::Segment;
use super::predictor::Gains;
use super::problem::{Problem, Step, Sweep, split};
use super::sensitivity::exponential_with_derivatives;

/// Magnitude beyond which a simulation has diverged.
const LARGEST: f64 = 1e9;
/// Number of sensitivity columns propagated together.
const LANES: usize = 8;
type Lane = [f64; LANES];

/// A linear model at one value of the parameters.
#[derive(Debug)]
pub struct Linear<'p> {
    problem: &'p Problem,
    gains: Option<&'p Gains>,
    /// [Phi Gamma], row after row.
    motion: Vec<f64>,
    /// Propagation of the state's sensitivities.
    flow: Flow,
    /// [C D], row after row.
    sensing: Vec<f64>,
    /// Parameters in C and D: parameter, output, index in [x; u].
    sensing_slopes: Vec<(usize, usize, usize)>,
    /// Number of parameters, including those of the noise model.
    parameters: usize,
    /// Padded number of sensitivities of the state: parameters and initial state.
    padded: usize,
}

impl<'p> Linear<'p> {
    /// The model at `theta`, predicting with `gains` or simulating without. `None` when its discretisation is
    /// not finite.
    pub fn new(problem: &'p Problem, theta: &[f64], gains: Option<&'p Gains>) -> Option<Self> {
        let (n, m, p) = (problem.n(), problem.m(), problem.p());
        let w = n + m;
        let [a, b, c, d] = problem.matrices_at(theta);
        let block = |a: &DMatrix<f64>, b: &DMatrix<f64>| {
            let mut block = DMatrix::zeros(w, w);
            block.view_mut((0, 0), (n, n)).copy_from(a);
            block.view_mut((0, n), (n, m)).copy_from(b);
            block * problem.period_s
        };
        let (mut directions, mut of) = (Vec::new(), Vec::new());
        let mut sensing_slopes = Vec::new();
        for parameter in 0..problem.parameters.len() {
            match problem.entry(parameter) {
                Some((Matrix::A, i, j)) => directions.push(Problem::unit(w, w, (i, j)) * problem.period_s),
                Some((Matrix::B, i, j)) => {
                    directions.push(Problem::unit(w, w, (i, n + j)) * problem.period_s)
                }
                Some((Matrix::C, i, j)) => {
                    sensing_slopes.push((parameter, i, j));
                    continue;
                }
                Some((Matrix::D, i, j)) => {
                    sensing_slopes.push((parameter, i, n + j));
                    continue;
                }
                None => continue,
            }
            of.push(parameter);
        }
        let (value, derivatives) = exponential_with_derivatives(&block(&a, &b), &directions)?;
        let parameters = problem.parameters.len() + gains.map_or(0, |g| g.noise_parameters);
        let states = if problem.nuisance.initial_state { n } else { 0 };
        // An output offset affects the state of a predictor, but not that of a simulation.
        let moved = if gains.is_some() { problem.nuisances() } else { states };
        let padded = (parameters + moved).next_multiple_of(LANES);
        let mut forces = vec![[0.0; LANES]; n * w * padded / LANES];
        for (derivative, parameter) in derivatives.iter().zip(of) {
            for (i, j) in (0..n).flat_map(|i| (0..w).map(move |j| (i, j))) {
                let chunk = (i * w + j) * padded + parameter;
                forces[chunk / LANES][parameter % LANES] = derivative[(i, j)];
            }
        }
        let flow = Flow::new(&value, &forces, n, padded);
        let rows = |m: &DMatrix<f64>, count: usize| -> Vec<f64> {
            (0..count).flat_map(|i| (0..w).map(move |j| (i, j))).map(|at| m[at]).collect()
        };
        let mut sensing = DMatrix::zeros(p, w);
        sensing.view_mut((0, 0), (p, n)).copy_from(&c);
        sensing.view_mut((0, n), (p, m)).copy_from(&d);
        Some(Self {
            problem,
            gains,
            motion: rows(&value, n),
            flow,
            sensing: rows(&sensing, p),
            sensing_slopes,
            parameters,
            padded,
        })
    }
}

impl Sweep for Linear<'_> {
    fn columns(&self) -> usize {
        self.parameters + self.problem.nuisances()
    }

    fn sweep(&self, segment: &Segment, nuisance: &[f64], visit: &mut dyn FnMut(Step<'_>)) -> bool {
        let (n, m, p) = (self.problem.n(), self.problem.m(), self.problem.p());
        let (w, q, columns) = (n + m, self.padded, self.columns());
        let (initial, offsets) = split(self.problem, nuisance);
        let first_offset = self.parameters + initial.len();
        let mut z = vec![0.0; w];
        z[..initial.len()].copy_from_slice(initial);
        let mut s = vec![0.0; n * q];
        for i in 0..initial.len() {
            s[i * q + self.parameters + i] = 1.0;
        }
        let mut next = s.clone();
        let mut x = vec![0.0; n];
        let mut predicted = vec![0.0; p];
        let mut slopes = vec![0.0; p * columns];
        let mut state_slopes = vec![0.0; p * q];
        for k in 0..segment.steps {
            z[n..].copy_from_slice(&segment.inputs[k * m..(k + 1) * m]);
            for i in 0..p {
                let row = &self.sensing[i * w..(i + 1) * w];
                let y: f64 = row.iter().zip(&z).map(|(c, z)| c * z).sum();
                predicted[i] = y + offsets.get(i).unwrap_or(&0.0);
                let slope = &mut state_slopes[i * q..(i + 1) * q];
                slope.fill(0.0);
                for (j, c) in row[..n].iter().enumerate().filter(|(_, c)| **c != 0.0) {
                    slope.iter_mut().zip(&s[j * q..(j + 1) * q]).for_each(|(o, s)| *o += c * s);
                }
            }
            for &(parameter, i, j) in &self.sensing_slopes {
                state_slopes[i * q + parameter] += z[j];
            }
            for i in 0..p {
                let row = &mut slopes[i * columns..(i + 1) * columns];
                let shared = columns.min(q);
                row[..shared].copy_from_slice(&state_slopes[i * q..i * q + shared]);
                if !offsets.is_empty() {
                    row[first_offset + i] += 1.0;
                }
            }
            visit(Step { k, predicted: &predicted, slopes: &slopes });

            for (x, row) in x.iter_mut().zip(self.motion.chunks_exact(w)) {
                *x = row.iter().zip(&z).map(|(a, z)| a * z).sum();
            }
            advance(&self.flow, &z, &s, &mut next);
            if let Some(gains) = self.gains {
                let measured = &segment.outputs[k * p..(k + 1) * p];
                gains.correct(k, measured, &predicted, &slopes, columns, &mut x, &mut next, q);
            }
            std::mem::swap(&mut s, &mut next);
            z[..n].copy_from_slice(&x);
            if !x.iter().all(|x| x.abs() < LARGEST) {
                return false;
            }
        }
        true
    }
}

/// S+ = Phi S + sum over j of z_j dPhi_j, with z = [x; u]: stored without the zeros, of which a model in
/// blocks or modes has many.
#[derive(Debug)]
struct Flow {
    padded: usize,
    /// Non-zero entries of Phi for every row of S+.
    rows: Vec<Vec<(usize, f64)>>,
    /// Forcing terms of some columns of a row: column, and the entries of z with their coefficients.
    forces: Vec<(usize, Vec<(usize, Lane)>)>,
}

impl Flow {
    /// `value` is [Phi Gamma; 0 I]; `forces` are its derivatives: (row, column of [x; u]) x padded columns.
    fn new(value: &DMatrix<f64>, forces: &[Lane], n: usize, padded: usize) -> Self {
        let (w, chunks) = (value.nrows(), padded / LANES);
        let entries = |i: usize| (0..n).map(move |j| (j, value[(i, j)])).filter(|(_, a)| *a != 0.0).collect();
        let force = |(i, c): (usize, usize)| {
            let parts = (0..w).map(|j| (j, forces[(i * w + j) * chunks + c]));
            (i * padded + c * LANES, parts.filter(|(_, lane)| *lane != [0.0; LANES]).collect::<Vec<_>>())
        };
        let all = (0..n).flat_map(|i| (0..chunks).map(move |c| (i, c)));
        Self {
            padded,
            rows: (0..n).map(entries).collect(),
            forces: all.map(force).filter(|(_, parts)| !parts.is_empty()).collect(),
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn advance(flow: &Flow, z: &[f64], s: &[f64], next: &mut [f64]) {
    let q = flow.padded;
    for (row, next) in flow.rows.iter().zip(next.chunks_exact_mut(q)) {
        for (c, next) in next.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            let mut sum = [0.0; LANES];
            for (j, a) in row {
                if let Some(s) = s[j * q + c * LANES..].first_chunk::<LANES>() {
                    sum.iter_mut().zip(s).for_each(|(sum, s)| *sum += a * s);
                }
            }
            *next = sum;
        }
    }
    for (at, parts) in &flow.forces {
        if let Some(next) = next[*at..].first_chunk_mut::<LANES>() {
            for (j, lane) in parts {
                let z = z[*j];
                next.iter_mut().zip(lane).for_each(|(next, lane)| *next += z * lane);
            }
        }
    }
}
