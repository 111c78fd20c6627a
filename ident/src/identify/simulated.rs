//! Simulation and one-step prediction of a vehicle with any effects, with sensitivities by central
//! differences.
//!
//! All simulators run side by side, step by step, so that only the current step is held in memory. Central
//! differences apply to every effect, including those with a threshold, and at an effect's null value they
//! give the signature by which diagnosis tests it; at the edge of a parameter's range the difference is
//! one-sided.
//!
//! A prediction corrects the state of each simulator by its own innovations, with the gain of the linear
//! model there: an observer that need not be optimal where an effect acts, but whose predictions are
//! unbiased.

use whirlstand_vehicle::Simulator;

use super::data::Segment;
use super::predictor::Gains;
use super::problem::{Problem, Step, Sweep, parameter_sides, split};

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
    /// Simulators with a larger and with a smaller value of each parameter, then of each noise parameter.
    perturbed: Vec<Pair>,
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
        let at = |theta: &[f64]| Simulator::expected(&problem.vehicle_at(theta), problem.period_s).ok();
        let centre = at(theta)?;
        let mut perturbed = Vec::with_capacity(theta.len());
        for (i, parameter) in problem.parameters.iter().enumerate() {
            let (mut above, mut below) = (theta.to_vec(), theta.to_vec());
            [above[i], below[i]] = parameter_sides(parameter, theta[i]);
            perturbed.push(Pair {
                above: at(&above)?,
                below: at(&below)?,
                moved: Some((i, above[i] - theta[i], below[i] - theta[i])),
                offset: None,
                inverse: 1.0 / (above[i] - below[i]),
            });
        }
        for i in 0..gains.map_or(0, |g| g.noise_parameters) {
            perturbed.push(Pair {
                above: centre.clone(),
                below: centre.clone(),
                moved: Some((theta.len() + i, NOISE_STEP, -NOISE_STEP)),
                offset: None,
                inverse: 0.5 / NOISE_STEP,
            });
        }
        Some(Self { problem, gains, centre, perturbed })
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
        let mut perturbed = self.neighbours(segment.first_step, &state, initial.len(), tracked);
        let first_offset = columns - offsets.len();
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
            if tracked == 0 {
                for i in 0..offsets.len() {
                    slopes[i * columns + first_offset + i] = 1.0;
                }
            }
            visit(&Step::new(k, &predicted, &slopes, columns, columns));
            centre.advance();
            if let Some(gains) = self.gains {
                gains.change(k, measured, &predicted, None, &mut change);
                centre.correct(&change);
            }
        }
        !centre.diverged() && predicted.iter().all(|y| y.is_finite())
    }
}
