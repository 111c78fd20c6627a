//! Simulation and one-step prediction of a linear model, with exact sensitivities.
//!
//! x+ = Phi x + Gamma u + K e, y = C x + D u + offset, e = y_measured - y (K = 0 for a simulation). The sensitivity
//! S = dx/d(theta, x0) obeys the derivative of the same recursion; a [`LinearStep`] has dPhi and dGamma. Effects on the
//! inputs are states and inputs of the step. No step allocates.

use std::array::from_fn;
use std::ops::Range;

use multiversion::multiversion;
use nalgebra::DMatrix;

use super::data::Segment;
use super::predictor::Gains;
use super::problem::{Divisible, Problem, Step, Sweep, split};
use super::step::{Drive, LinearStep, Slope};

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
    step: LinearStep,
    /// Number of parameters, including those of the noise model.
    parameters: usize,
    /// Padded number of sensitivities of the state: parameters and initial state.
    padded: usize,
}

impl<'p> Linear<'p> {
    /// The model at `theta`, predicting with `gains` or simulating without. `None` when its discretisation is
    /// not finite, and when an effect acts elsewhere than on an input.
    pub fn new(problem: &'p Problem, theta: &[f64], gains: Option<&'p Gains>) -> Option<Self> {
        let step = LinearStep::new(problem, theta)?;
        let (n, w) = step.motion.shape();
        let parameters = problem.parameters.len() + gains.map_or(0, |g| g.noise_parameters);
        let states = if problem.nuisance.initial_state { problem.n() } else { 0 };
        // An output offset affects the state of a predictor, but not that of a simulation.
        let moved = if gains.is_some() { problem.nuisances() } else { states };
        let padded = (parameters + moved).next_multiple_of(LANES);
        let mut forces = vec![[0.0; LANES]; n * w * padded / LANES];
        for Slope { parameter, row, column, value } in &step.motion_slopes {
            let chunk = (row * w + column) * padded + parameter;
            forces[chunk / LANES][parameter % LANES] += value;
        }
        let flow = Flow::new(&step.motion, &forces, padded);
        let rows = |m: &DMatrix<f64>| m.transpose().as_slice().to_vec();
        let shown = step
            .sensing
            .row_iter()
            .map(|row| row.iter().copied().take(n).enumerate().filter(|(_, c)| *c != 0.0).collect());
        Some(Self {
            problem,
            gains,
            motion: rows(&step.motion),
            flow,
            sensing: rows(&step.sensing),
            shown: shown.collect(),
            step,
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
        let whole = self.gains.is_none() && self.problem.nuisance.initial_state;
        (whole && matches!(self.step.drive, Drive::Recorded)).then_some(self)
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
        let (own, m, p) = (self.problem.n(), self.problem.m(), self.problem.p());
        let (n, w) = self.step.motion.shape();
        let (q, columns) = (self.padded, self.columns());
        let (initial, offsets) = split(self.problem, nuisance);
        let first_offset = self.parameters + initial.len();
        let mut drive = self.step.drive.clone();
        drive.begin_at(segment.first_step);
        let mut z = vec![0.0; w];
        z[..n].copy_from_slice(&self.step.start);
        z[..initial.len()].copy_from_slice(initial);
        let mut s = vec![0.0; n.next_multiple_of(ROWS) * q];
        for Slope { parameter, row, value, .. } in &self.step.start_slopes {
            s[row * q + parameter] = *value;
        }
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
            drive.next(&segment.inputs[k * m..(k + 1) * m], &mut z[n..]);
            let sensed = self.sensing.chunks_exact(w).zip(&self.step.offsets);
            for (i, (y, (row, own))) in predicted.iter_mut().zip(sensed).enumerate() {
                let shown = row.iter().zip(&z).map(|(c, z)| c * z).sum::<f64>();
                *y = shown + own + offsets.get(i).unwrap_or(&0.0);
            }
            show(&self.shown, &s, q, &mut slopes, stride);
            for Slope { parameter, row, column, value } in &self.step.sensing_slopes {
                slopes[row * stride + parameter] += value * z[*column];
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
                gains.correct(&step, &segment.outputs[k * p..(k + 1) * p], &mut x[..own], &mut next, q);
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
    /// `value` is [Phi Gamma]; `forces` are its derivatives: (row, column of [x; u]) x padded columns.
    fn new(value: &DMatrix<f64>, forces: &[Lane], padded: usize) -> Self {
        let ((n, w), lanes) = (value.shape(), padded / LANES);
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

#[cfg(test)]
mod tests {
    use whirlstand_vehicle::Vehicle;

    use super::super::predictor::{NoiseStructure, Pattern};
    use super::super::problem::Nuisance;
    use super::super::simulated::Simulated;
    use super::*;

    fn axis(more: &str) -> Vehicle {
        let text = format!(
            r#"
            A = [[0.0, 1.0], [-9.0, -2.0]]
            B = [[0.0, 0.0], [5.0, 3.0]]
            C = [[1.0, 0.0], [0.0, 1.0]]
            D = [[0.0, 0.1], [0.0, 0.0]]
            states = [{{ name = "roll" }}, {{ name = "roll_rate" }}]
            inputs = [{{ name = "u" }}, {{ name = "v" }}]
            outputs = [{{ name = "roll", bias = 0.03 }}, {{ name = "roll_rate" }}]
            free = [
                {{ entry = "A[2,1]", lower = -20.0, upper = 0.0 }},
                {{ entry = "C[1,1]", lower = 0.5, upper = 2.0 }},
                {{ entry = "D[1,2]", lower = -1.0, upper = 1.0 }},
                {{ effect = "actuator_lag", where = "u", parameter = "time_constant_s", lower = 0.01, upper = 1.0 }},
                {{ effect = "input_delay", where = "u", parameter = "delay_s", lower = 0.0, upper = 0.1 }},
                {{ effect = "dead_zone", where = "v", parameter = "width", lower = 0.0, upper = 1.0 }},
                {{ effect = "input_gain", where = "v", parameter = "factor", lower = 0.2, upper = 2.0 }},
            ]
            effects = [
                {{ effect = "actuator_lag", where = "u", time_constant_s = 0.05 }},
                {{ effect = "input_delay", where = "u", delay_s = 0.013 }},
                {{ effect = "dead_zone", where = "v", width = 0.2 }},
                {{ effect = "input_gain", where = "v", factor = 0.8 }},
                {{ effect = "input_delay", where = "v", delay_s = 0.006 }},
                {more}
            ]
            "#
        );
        Vehicle::parse(&text, "axis.toml").unwrap()
    }

    fn record() -> Segment {
        let (steps, period_s) = (200, 0.01);
        let wave = |k: usize, f: f64| (k as f64 * period_s * f).sin();
        Segment {
            origin: "axis".into(),
            start_s: 0.0,
            first_step: 0,
            period_s,
            inputs: (0..steps).flat_map(|k| [wave(k, 9.0), wave(k, 5.0)]).collect(),
            outputs: (0..steps).flat_map(|k| [wave(k, 8.0), 8.0 * wave(k, 7.0)]).collect(),
            steps,
        }
    }

    /// The recursion and differences of simulators are the same, with and without a filter. Where a delay is a whole number of
    /// steps, on both sides of which it has not the same matrices, the derivative is that of a longer one.
    #[test]
    fn effects_on_inputs_need_no_simulators() {
        let (vehicle, segment) = (axis(""), record());
        let nuisance = Nuisance { initial_state: true, output_offsets: true };
        let problem = Problem::new(&vehicle, std::slice::from_ref(&segment), nuisance).unwrap();
        let structure = NoiseStructure::new(&problem);
        let nuisances = [0.1, -0.2, 0.01, 0.02];
        for (delay_s, beside) in [(0.013, 0.013), (0.02, 0.020_000_4)] {
            let theta = [-9.0, 1.1, 0.1, 0.05, delay_s, 0.2, 0.8];
            let pattern = Pattern::of(&segment, 2);
            let gains = Gains::new(&problem, &structure, &pattern, &theta, &[0.5, -3.0, -2.0], true).unwrap();
            for gains in [None, Some(&gains)] {
                let seen = |model: &dyn Sweep| {
                    let mut all: Vec<f64> = Vec::new();
                    assert!(model.sweep(&segment, &nuisances, &mut |step| {
                        all.extend(step.predicted);
                        (0..2).for_each(|i| all.extend(step.slopes(i)));
                    }));
                    (model.columns(), all)
                };
                let (columns, exact) = seen(&Linear::new(&problem, &theta, gains).unwrap());
                let beside = [-9.0, 1.1, 0.1, 0.05, beside, 0.2, 0.8];
                let (others, differences) = seen(&Simulated::new(&problem, &beside, gains).unwrap());
                assert_eq!(columns, others);
                assert_eq!(columns, 7 + gains.map_or(0, |_| 3) + 4);
                for (k, (a, b)) in exact.iter().zip(&differences).enumerate() {
                    assert!((a - b).abs() < 2e-5 * b.abs().max(1.0), "{delay_s} {k}: {a} {b}");
                }
            }
        }
    }

    /// A delay at the end of its range and of whole steps, and a dead zone of none: there is a difference on one side, or none.
    #[test]
    fn derivatives_at_the_ends_of_ranges_are_finite() {
        let (vehicle, segment) = (axis(""), record());
        let problem = Problem::new(&vehicle, std::slice::from_ref(&segment), Nuisance::default()).unwrap();
        for (theta, is_linear) in [
            ([-9.0, 1.1, 0.1, 0.05, 0.1, 0.2, 0.8], false),
            ([-9.0, 1.1, 0.1, 0.05, 0.0, 0.2, 0.8], true),
            ([0.0, 0.5, 1.0, 0.01, 0.013, 0.0, 0.2], true),
        ] {
            assert_eq!(Linear::new(&problem, &theta, None).is_some(), is_linear, "{theta:?}");
            let model = crate::identify::sweep::simulation(&problem, &theta).unwrap();
            assert!(model.sweep(&segment, &[0.0; 2], &mut |step| {
                (0..2).for_each(|i| assert!(step.slopes(i).iter().all(|d| d.is_finite()), "{theta:?}"));
            }));
        }
    }

    #[test]
    fn what_acts_on_the_motion_or_a_sensor_is_not_linear_behind_the_inputs() {
        let segment = record();
        for more in [
            "{ effect = 'sensor_lag', where = 'roll', time_constant_s = 0.1 }",
            "{ effect = 'cubic_stiffness', where = 'roll->roll_rate', coefficient = 1.0 }",
        ] {
            let problem =
                Problem::new(&axis(more), std::slice::from_ref(&segment), Nuisance::default()).unwrap();
            assert!(
                Linear::new(&problem, &[-9.0, 1.1, 0.1, 0.05, 0.013, 0.2, 0.8], None).is_none(),
                "{more}"
            );
        }
    }
}
