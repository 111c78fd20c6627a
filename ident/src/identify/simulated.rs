//! Simulation and one-step prediction of a vehicle with any effects, with sensitivities by central
//! differences.
//!
//! All simulators run side by side, step by step, so that only the current step is held in memory. Central
//! differences apply to every effect, including those with a threshold, and at an effect's null value they
//! give the signature by which diagnosis tests it; at the edge of a parameter's range the difference is
//! one-sided.
//!
//! Where all effects act on the inputs, the vehicle behind them is linear: the derivatives by the initial state, the offsets
//! and the noises, on which the inputs' effects do not depend, obey its own recursion and need no simulators.
//!
//! A prediction corrects the state of each simulator by its own innovations, with the gain of the linear
//! model there: an observer that need not be optimal where an effect acts, but whose predictions are
//! unbiased.

use nalgebra::DMatrix;
use whirlstand_vehicle::{Place, Simulator, Vehicle, discretise};

use super::data::Segment;
use super::predictor::Gains;
use super::problem::{Problem, Step, Sweep, split};

/// Perturbation of a parameter in a central difference, as a share of its range.
const PARAMETER_STEP: f64 = 1e-5;
/// Perturbation of an initial state and of an offset, in their own units.
const STATE_STEP: f64 = 1e-3;

/// Perturbation of a noise parameter, which is a logarithm.
const NOISE_STEP: f64 = 1e-3;

/// A simulator at the current parameters, and one on either side of it for each parameter.
#[derive(Debug)]
pub struct Simulated<'p> {
    problem: &'p Problem,
    gains: Option<&'p Gains>,
    centre: Simulator,
    /// Simulators with a larger and with a smaller value of each parameter; of each noise parameter as well, unless the
    /// state moves by `linear`.
    perturbed: Vec<Pair>,
    /// How the state moves and shows where all effects act on the inputs.
    linear: Option<LinearPart>,
}

/// Motion of the state within a step, and the outputs of a state.
#[derive(Debug)]
struct LinearPart {
    phi: DMatrix<f64>,
    c: DMatrix<f64>,
}

impl LinearPart {
    fn behind_the_inputs(vehicle: &Vehicle, period_s: f64) -> Option<Self> {
        let of_input = |place| matches!(place, Place::Input(_) | Place::InputPair(..));
        let all = vehicle.effects.iter().all(|effect| effect.resolve(vehicle).is_ok_and(of_input));
        let (phi, _) = all.then(|| discretise(&vehicle.a, &vehicle.b, period_s))?.ok()?;
        Some(Self { phi, c: vehicle.c.clone() })
    }

    /// Derivatives of the outputs by the columns from `first` on, of the state's derivatives `s`; rows of both have
    /// `columns`.
    fn show(&self, s: &[f64], slopes: &mut [f64], first: usize, columns: usize) {
        multiply(&self.c, s, slopes, first, columns);
    }

    /// The state's derivatives a step later.
    fn advance(&self, s: &mut [f64], next: &mut [f64], first: usize, columns: usize) {
        multiply(&self.phi, s, next, first, columns);
        s.copy_from_slice(next);
    }
}

/// The product of a matrix and the columns from `first` on of `right`, row after row.
fn multiply(left: &DMatrix<f64>, right: &[f64], product: &mut [f64], first: usize, columns: usize) {
    for (i, row) in product.chunks_exact_mut(columns).enumerate() {
        let row = &mut row[first..];
        row.fill(0.0);
        for (j, other) in right.chunks_exact(columns).enumerate() {
            let factor = left[(i, j)];
            if factor != 0.0 {
                row.iter_mut().zip(&other[first..]).for_each(|(p, r)| *p += factor * r);
            }
        }
    }
}

/// The simulators on both sides of one parameter.
#[derive(Debug, Clone)]
struct Pair {
    above: Simulator,
    below: Simulator,
    /// The parameter on which the gains depend, and the distances of `above` and `below` from the centre;
    /// `None` for an initial state or an offset, on which the gains do not depend.
    moved: Option<(usize, f64, f64)>,
    /// For an offset the output, and what is added to it in `above` and subtracted in `below`.
    offset: Option<(usize, f64)>,
    /// Inverse of the distance between `above` and `below`.
    inverse: f64,
}

impl Pair {
    /// Applies a command, and writes the outputs on both sides.
    fn measure(&mut self, u: &[f64], offsets: &[f64], above: &mut [f64], below: &mut [f64]) {
        for (simulator, y, side) in [(&mut self.above, above, 1.0), (&mut self.below, below, -1.0)] {
            simulator.apply(u);
            y.copy_from_slice(simulator.measure());
            y.iter_mut().zip(offsets).for_each(|(y, o)| *y += o);
            if let Some((output, size)) = self.offset {
                y[output] += side * size;
            }
        }
    }

    /// Corrects both states by the innovations of step `k`.
    fn correct(
        &mut self,
        gains: &Gains,
        (k, measured): (usize, &[f64]),
        (above, below): (&[f64], &[f64]),
        change: &mut [f64],
    ) {
        let moved = |side: fn((usize, f64, f64)) -> (usize, f64)| self.moved.map(side);
        gains.change(k, measured, above, moved(|(i, a, _)| (i, a)), change);
        self.above.correct(change);
        gains.change(k, measured, below, moved(|(i, _, b)| (i, b)), change);
        self.below.correct(change);
    }
}

impl<'p> Simulated<'p> {
    /// The simulators at `theta`, predicting with `gains` or running freely without; `None` when one has no
    /// finite discretisation.
    pub fn new(problem: &'p Problem, theta: &[f64], gains: Option<&'p Gains>) -> Option<Self> {
        let linear = LinearPart::behind_the_inputs(&problem.vehicle_at(theta), problem.period_s);
        Self::with(problem, theta, gains, linear)
    }

    fn with(
        problem: &'p Problem,
        theta: &[f64],
        gains: Option<&'p Gains>,
        linear: Option<LinearPart>,
    ) -> Option<Self> {
        let at = |theta: &[f64]| Simulator::expected(&problem.vehicle_at(theta), problem.period_s).ok();
        let centre = at(theta)?;
        let mut perturbed = Vec::with_capacity(theta.len());
        for (i, parameter) in problem.parameters.iter().enumerate() {
            let step = PARAMETER_STEP
                * (parameter.upper - parameter.lower)
                    .min(theta[i].abs().max(1e-2 * (parameter.upper - parameter.lower)));
            let (mut above, mut below) = (theta.to_vec(), theta.to_vec());
            above[i] = (theta[i] + step).min(parameter.upper);
            below[i] = (theta[i] - step).max(parameter.lower);
            perturbed.push(Pair {
                above: at(&above)?,
                below: at(&below)?,
                moved: Some((i, above[i] - theta[i], below[i] - theta[i])),
                offset: None,
                inverse: 1.0 / (above[i] - below[i]),
            });
        }
        for i in 0..gains.filter(|_| linear.is_none()).map_or(0, |g| g.noise_parameters) {
            perturbed.push(Pair {
                above: centre.clone(),
                below: centre.clone(),
                moved: Some((theta.len() + i, NOISE_STEP, -NOISE_STEP)),
                offset: None,
                inverse: 0.5 / NOISE_STEP,
            });
        }
        Some(Self { problem, gains, centre, perturbed, linear })
    }

    /// The perturbed simulators for all parameters and nuisances that need them, at the start of a segment.
    fn neighbours(&self, first_step: u64, state: &[f64], states: usize, offsets: usize) -> Vec<Pair> {
        let ready = |simulator: &Simulator, state: &[f64]| {
            let mut simulator = simulator.clone();
            simulator.begin_at(first_step);
            simulator.set_state(state);
            simulator
        };
        let mut all: Vec<Pair> = self
            .perturbed
            .iter()
            .map(|p| Pair { above: ready(&p.above, state), below: ready(&p.below, state), ..p.clone() })
            .collect();
        for i in 0..states {
            let (mut above, mut below) = (state.to_vec(), state.to_vec());
            above[i] += STATE_STEP;
            below[i] -= STATE_STEP;
            all.push(Pair {
                above: ready(&self.centre, &above),
                below: ready(&self.centre, &below),
                moved: None,
                offset: None,
                inverse: 0.5 / STATE_STEP,
            });
        }
        for i in 0..offsets {
            let centre = ready(&self.centre, state);
            all.push(Pair {
                above: centre.clone(),
                below: centre,
                moved: None,
                offset: Some((i, STATE_STEP)),
                inverse: 0.5 / STATE_STEP,
            });
        }
        all
    }
}

impl Sweep for Simulated<'_> {
    fn columns(&self) -> usize {
        let noises = self.gains.map_or(0, |g| g.noise_parameters);
        self.problem.parameters.len() + noises + self.problem.nuisances()
    }

    fn sweep(&self, segment: &Segment, nuisance: &[f64], visit: &mut dyn FnMut(&Step<'_>)) -> bool {
        let (n, m, p) = (self.problem.n(), self.problem.m(), self.problem.p());
        let columns = self.columns();
        let (initial, offsets) = split(self.problem, nuisance);
        let mut state = vec![0.0; n];
        state[..initial.len()].copy_from_slice(initial);
        let mut centre = self.centre.clone();
        centre.begin_at(segment.first_step);
        centre.set_state(&state);
        // An offset affects the state of a predictor but not that of a simulation, where its sensitivity is
        // one.
        let tracked = if self.gains.is_some() { offsets.len() } else { 0 };
        let simulated = if self.linear.is_some() { (0, 0) } else { (initial.len(), tracked) };
        let mut perturbed = self.neighbours(segment.first_step, &state, simulated.0, simulated.1);
        let (first, first_offset) = (perturbed.len(), columns - offsets.len());
        // Derivatives of the state, for the columns from `first` on.
        let mut s = vec![0.0; n * columns];
        let mut next = s.clone();
        for i in 0..initial.len() {
            s[i * columns + first_offset - initial.len() + i] = 1.0;
        }
        let mut aside = vec![0.0; n];
        let mut predicted = vec![0.0; p];
        let mut slopes = vec![0.0; p * columns];
        let (mut above, mut below) = (vec![0.0; p], vec![0.0; p]);
        let mut change = vec![0.0; n];
        for k in 0..segment.steps {
            let u = &segment.inputs[k * m..(k + 1) * m];
            let measured = &segment.outputs[k * p..(k + 1) * p];
            centre.apply(u);
            predicted.copy_from_slice(centre.measure());
            predicted.iter_mut().zip(offsets).for_each(|(y, o)| *y += o);
            for (column, pair) in perturbed.iter_mut().enumerate() {
                pair.measure(u, offsets, &mut above, &mut below);
                for (i, (a, b)) in above.iter().zip(&below).enumerate() {
                    slopes[i * columns + column] = (a - b) * pair.inverse;
                }
                pair.above.advance();
                pair.below.advance();
                if let Some(gains) = self.gains {
                    pair.correct(gains, (k, measured), (&above, &below), &mut change);
                }
            }
            if let Some(linear) = &self.linear {
                linear.show(&s, &mut slopes, first, columns);
            }
            if tracked == 0 || self.linear.is_some() {
                for i in 0..offsets.len() {
                    let slope = &mut slopes[i * columns + first_offset + i];
                    *slope = if self.linear.is_some() { *slope + 1.0 } else { 1.0 };
                }
            }
            let step = Step::new(k, &predicted, &slopes, columns, columns);
            visit(&step);
            if let Some(linear) = &self.linear {
                linear.advance(&mut s, &mut next, first, columns);
                if let Some(gains) = self.gains {
                    gains.correct(&step, measured, &mut aside, &mut s, columns);
                }
            }
            centre.advance();
            if let Some(gains) = self.gains {
                gains.change(k, measured, &predicted, None, &mut change);
                centre.correct(&change);
            }
        }
        !centre.diverged() && predicted.iter().all(|y| y.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::super::predictor::{NoiseStructure, Pattern};
    use super::super::problem::Nuisance;
    use super::*;

    /// The recursion of the state's derivatives and differences of simulators are the same, with and without a filter.
    #[test]
    fn what_is_linear_behind_the_inputs_needs_no_simulators() {
        let text = r#"
            A = [[0.0, 1.0], [-9.0, -2.0]]
            B = [[0.0, 0.0], [5.0, 3.0]]
            C = [[1.0, 0.0], [0.0, 1.0]]
            states = [{ name = "roll" }, { name = "roll_rate" }]
            inputs = [{ name = "u" }, { name = "v" }]
            outputs = [{ name = "roll" }, { name = "roll_rate" }]
            free = [
                { entry = "A[2,1]", lower = -20.0, upper = 0.0 },
                { effect = "actuator_lag", where = "u", parameter = "time_constant_s", lower = 0.01, upper = 1.0 },
                { effect = "dead_zone", where = "v", parameter = "width", lower = 0.0, upper = 1.0 },
            ]
            [[effects]]
            effect = "actuator_lag"
            where = "u"
            time_constant_s = 0.05
            [[effects]]
            effect = "input_delay"
            where = "u"
            delay_s = 0.013
            [[effects]]
            effect = "dead_zone"
            where = "v"
            width = 0.2
        "#;
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let (steps, period_s) = (200, 0.01);
        let wave = |k: usize, f: f64| (k as f64 * period_s * f).sin();
        let segment = Segment {
            origin: "axis".into(),
            start_s: 0.0,
            first_step: 0,
            period_s,
            inputs: (0..steps).flat_map(|k| [wave(k, 9.0), wave(k, 5.0)]).collect(),
            outputs: (0..steps).flat_map(|k| [wave(k, 8.0), 8.0 * wave(k, 7.0)]).collect(),
            steps,
        };
        let nuisance = Nuisance { initial_state: true, output_offsets: true };
        let problem = Problem::new(&vehicle, std::slice::from_ref(&segment), nuisance).unwrap();
        let structure = NoiseStructure::new(&problem);
        let theta = [-9.0, 0.05, 0.2];
        let pattern = Pattern::of(&segment, 2);
        let gains = Gains::new(&problem, &structure, &pattern, &theta, &[0.5, -3.0, -2.0], true).unwrap();
        let nuisances = [0.1, -0.2, 0.01, 0.02];
        for gains in [None, Some(&gains)] {
            let seen = |model: &Simulated<'_>| {
                let mut all: Vec<f64> = Vec::new();
                assert!(model.sweep(&segment, &nuisances, &mut |step| {
                    all.extend(step.predicted);
                    (0..2).for_each(|i| all.extend(step.slopes(i)));
                }));
                (model.columns(), all)
            };
            let linear = LinearPart::behind_the_inputs(&vehicle, period_s);
            assert!(linear.is_some());
            let (columns, exact) = seen(&Simulated::with(&problem, &theta, gains, linear).unwrap());
            let (others, differences) = seen(&Simulated::with(&problem, &theta, gains, None).unwrap());
            assert_eq!(columns, others);
            assert_eq!(columns, 3 + gains.map_or(0, |_| 3) + 4);
            for (k, (a, b)) in exact.iter().zip(&differences).enumerate() {
                assert!((a - b).abs() < 1e-5 * b.abs().max(1.0), "{k}: {a} {b}");
            }
        }
    }

    #[test]
    fn what_acts_on_the_motion_or_a_sensor_is_not_linear_behind_the_inputs() {
        for effect in [
            "effect = 'sensor_lag'\nwhere = 'roll'\ntime_constant_s = 0.1",
            "effect = 'cubic_stiffness'\nwhere = 'roll->roll_rate'\ncoefficient = 1.0",
        ] {
            let text = format!(
                "A = [[0.0, 1.0], [-9.0, -2.0]]\nB = [[0.0], [5.0]]\nstates = [{{ name = 'roll' }}, {{ name = 'roll_rate' }}]\ninputs = [{{ name = 'u' }}]\n[[effects]]\n{effect}\n"
            );
            let vehicle = Vehicle::parse(&text, "axis.toml").unwrap();
            assert!(LinearPart::behind_the_inputs(&vehicle, 0.01).is_none(), "{effect}");
        }
    }
}
