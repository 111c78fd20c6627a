//! Simulation and one-step prediction of a linear model, with exact sensitivities.
//!
//! x+ = Phi x + Gamma u + K e, y = C x + D u + offset, e = y_measured - y (K = 0 for a simulation). The sensitivity
//! S = dx/d(theta, x0) obeys the derivative of the same recursion; dPhi and dGamma come from the Frechet derivative
//! of the matrix exponential, so that nothing is differenced. No step allocates.

use std::array::from_fn;
use std::ops::Range;

use multiversion::multiversion;
use nalgebra::DMatrix;
use whirlstand_vehicle::Matrix;

use super::data::Segment;
use super::predictor::Gains;
use super::problem::{Divisible, Problem, Step, Sweep, split};
use super::sensitivity::exponential_with_derivatives;

/// Magnitude beyond which a simulation has diverged.
const LARGEST: f64 = 1e9;
/// Number of sensitivity columns propagated together.
const LANES: usize = 8;
type Lane = [f64; LANES];
/// Number of rows of the state's sensitivities propagated together.
const ROWS: usize = 4;

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
    /// Non-zero entries of C for every output.
    shown: Vec<Vec<(usize, f64)>>,
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
        let shown = (0..p).map(|i| (0..n).map(|j| (j, c[(i, j)])).filter(|(_, c)| *c != 0.0).collect());
        Some(Self {
            problem,
            gains,
            motion: rows(&value, n),
            flow,
            sensing: rows(&sensing, p),
            shown: shown.collect(),
            sensing_slopes,
            parameters,
            padded,
        })
    }
}

impl Linear<'_> {
    /// The state after z = [x; u].
    fn move_on(&self, z: &[f64], x: &mut [f64]) {
        for (x, row) in x.iter_mut().zip(self.motion.chunks_exact(z.len())) {
            *x = row.iter().zip(z).map(|(a, z)| a * z).sum();
        }
    }
}

impl Sweep for Linear<'_> {
    fn columns(&self) -> usize {
        self.parameters + self.problem.nuisances()
    }

    fn sweep(&self, segment: &Segment, nuisance: &[f64], visit: &mut dyn FnMut(&Step<'_>)) -> bool {
        self.sweep_part(segment, 0..segment.steps, nuisance, visit).is_some()
    }

    fn divisible(&self) -> Option<&dyn Divisible> {
        // A predictor's state depends on its innovations too.
        (self.gains.is_none() && self.problem.nuisance.initial_state).then_some(self)
    }
}

impl Divisible for Linear<'_> {
    fn sweep_part(
        &self,
        segment: &Segment,
        steps: Range<usize>,
        nuisance: &[f64],
        visit: &mut dyn FnMut(&Step<'_>),
    ) -> Option<DMatrix<f64>> {
        let (n, m, p) = (self.problem.n(), self.problem.m(), self.problem.p());
        let (w, q, columns) = (n + m, self.padded, self.columns());
        let (initial, offsets) = split(self.problem, nuisance);
        let first_offset = self.parameters + initial.len();
        let mut z = vec![0.0; w];
        z[..initial.len()].copy_from_slice(initial);
        let mut s = vec![0.0; n.next_multiple_of(ROWS) * q];
        for i in 0..initial.len() {
            s[i * q + self.parameters + i] = 1.0;
        }
        let mut next = s.clone();
        let mut x = vec![0.0; n];
        let mut predicted = vec![0.0; p];
        // Whole lanes for every output; an offset moves no state of a simulation and may lie beyond those of the state.
        let stride = columns.next_multiple_of(LANES);
        let mut slopes = vec![0.0; p * stride];
        for k in steps {
            z[n..].copy_from_slice(&segment.inputs[k * m..(k + 1) * m]);
            for (i, (y, row)) in predicted.iter_mut().zip(self.sensing.chunks_exact(w)).enumerate() {
                *y = row.iter().zip(&z).map(|(c, z)| c * z).sum::<f64>() + offsets.get(i).unwrap_or(&0.0);
            }
            show(&self.shown, &s, q, &mut slopes, stride);
            for &(parameter, i, j) in &self.sensing_slopes {
                slopes[i * stride + parameter] += z[j];
            }
            for i in 0..offsets.len() {
                let own = &mut slopes[i * stride + first_offset + i];
                *own = if self.gains.is_some() { *own + 1.0 } else { 1.0 };
            }
            let step = Step::new(k, &predicted, &slopes, columns, stride);
            visit(&step);

            self.move_on(&z, &mut x);
            advance(&self.flow, &z, &s, &mut next);
            if let Some(gains) = self.gains {
                gains.correct(&step, &segment.outputs[k * p..(k + 1) * p], &mut x, &mut next, q);
            }
            std::mem::swap(&mut s, &mut next);
            z[..n].copy_from_slice(&x);
            if !x.iter().all(|x| x.abs() < LARGEST) {
                return None;
            }
        }
        let shared = columns.min(q);
        Some(DMatrix::from_fn(n, columns, |i, j| if j < shared { s[i * q + j] } else { 0.0 }))
    }

    fn states(&self, segment: &Segment, nuisance: &[f64], at: &[usize]) -> Option<Vec<Vec<f64>>> {
        let (n, m) = (self.problem.n(), self.problem.m());
        let mut z = vec![0.0; n + m];
        z[..n].copy_from_slice(split(self.problem, nuisance).0);
        let mut x = vec![0.0; n];
        let (mut found, mut from) = (Vec::with_capacity(at.len()), 0);
        for end in at {
            for k in from..*end {
                z[n..].copy_from_slice(&segment.inputs[k * m..(k + 1) * m]);
                self.move_on(&z, &mut x);
                z[..n].copy_from_slice(&x);
            }
            from = *end;
            found.push(z[..n].to_vec());
        }
        found.iter().flatten().all(|x| x.abs() < LARGEST).then_some(found)
    }
}

/// S+ = Phi S + sum over j of z_j dPhi_j, with z = [x; u], for some rows of S at once, so that their sums stay in
/// registers; without the blocks that are zero, of which a model in blocks or modes has many.
#[derive(Debug)]
struct Flow {
    padded: usize,
    blocks: Vec<Block>,
}

/// [`ROWS`] rows of S+; those beyond the last state are zero.
#[derive(Debug)]
struct Block {
    /// Row of S and its factors in these rows of S+: columns of Phi.
    motion: Vec<(usize, [f64; ROWS])>,
    /// Forcing terms of each lane of columns: entry of z, and its coefficients in these rows.
    forces: Vec<Vec<(usize, [Lane; ROWS])>>,
}

impl Flow {
    /// `value` is [Phi Gamma; 0 I]; `forces` are its derivatives: (row, column of [x; u]) x padded columns.
    fn new(value: &DMatrix<f64>, forces: &[Lane], n: usize, padded: usize) -> Self {
        let (w, lanes) = (value.nrows(), padded / LANES);
        let block = |first: usize| {
            let factors = |j: usize| from_fn(|i| if first + i < n { value[(first + i, j)] } else { 0.0 });
            let lane = |i: usize, j: usize, c: usize| {
                if i < n { forces[(i * w + j) * lanes + c] } else { [0.0; LANES] }
            };
            let terms = |c: usize| {
                let all = (0..w).map(|j| (j, from_fn(|i| lane(first + i, j, c))));
                all.filter(|(_, rows)| *rows != [[0.0; LANES]; ROWS]).collect()
            };
            Block {
                motion: (0..n).map(|j| (j, factors(j))).filter(|(_, a)| *a != [0.0; ROWS]).collect(),
                forces: (0..lanes).map(terms).collect(),
            }
        };
        Self { padded, blocks: (0..n).step_by(ROWS).map(block).collect() }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn advance(flow: &Flow, z: &[f64], s: &[f64], next: &mut [f64]) {
    let q = flow.padded;
    for (block, next) in flow.blocks.iter().zip(next.chunks_exact_mut(ROWS * q)) {
        for (c, forces) in block.forces.iter().enumerate() {
            let mut sums = [[0.0; LANES]; ROWS];
            for (j, factors) in &block.motion {
                let Some(s) = s[j * q + c * LANES..].first_chunk::<LANES>() else { continue };
                for (sum, a) in sums.iter_mut().zip(factors) {
                    sum.iter_mut().zip(s).for_each(|(sum, s)| *sum += a * s);
                }
            }
            for (j, lanes) in forces {
                let z = z[*j];
                for (sum, lane) in sums.iter_mut().zip(lanes) {
                    sum.iter_mut().zip(lane).for_each(|(sum, lane)| *sum += z * lane);
                }
            }
            for (i, sum) in sums.iter().enumerate() {
                next[i * q + c * LANES..][..LANES].copy_from_slice(sum);
            }
        }
    }
}

/// Writes C S, the outputs' sensitivities as far as the state shows in them; rows of `slopes` begin every `stride`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn show(shown: &[Vec<(usize, f64)>], s: &[f64], q: usize, slopes: &mut [f64], stride: usize) {
    for (row, slopes) in shown.iter().zip(slopes.chunks_exact_mut(stride)) {
        for (c, slopes) in slopes[..q].as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
            let mut sum = [0.0; LANES];
            for (j, a) in row {
                if let Some(s) = s[j * q + c * LANES..].first_chunk::<LANES>() {
                    sum.iter_mut().zip(s).for_each(|(sum, s)| *sum += a * s);
                }
            }
            *slopes = sum;
        }
    }
}
