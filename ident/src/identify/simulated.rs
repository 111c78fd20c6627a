//! Simulation of a vehicle with any effects, with sensitivities by central differences.
//!
//! All simulators run side by side, step by step, so that nothing but the present step is held in memory. Central
//! differences serve every effect alike, those with a threshold too, and at an effect's null value they give the
//! signature by which diagnosis tests it; where a value lies at the edge of its range, the difference is one-sided.

use whirlstand_vehicle::Simulator;

use super::data::Segment;
use super::problem::{Problem, Step, Sweep, split};

/// Share of a parameter's range by which it is moved for a difference.
const MOVE: f64 = 1e-5;
/// By how much a state is moved.
const NUDGE: f64 = 1e-3;

/// A simulator and its neighbours.
#[derive(Debug)]
pub struct Simulated<'p> {
    problem: &'p Problem,
    centre: Simulator,
    /// For each parameter: the simulators above and below and their distance.
    beside: Vec<(Simulator, Simulator, f64)>,
}

impl<'p> Simulated<'p> {
    /// The simulators at `theta`; `None` when one has no finite step.
    pub fn new(problem: &'p Problem, theta: &[f64]) -> Option<Self> {
        let at = |theta: &[f64]| Simulator::expected(&problem.vehicle_at(theta), problem.period_s).ok();
        let centre = at(theta)?;
        let mut beside = Vec::with_capacity(theta.len());
        for (i, parameter) in problem.parameters.iter().enumerate() {
            let step = MOVE
                * (parameter.upper - parameter.lower)
                    .min(theta[i].abs().max(1e-2 * (parameter.upper - parameter.lower)));
            let (mut above, mut below) = (theta.to_vec(), theta.to_vec());
            above[i] = (theta[i] + step).min(parameter.upper);
            below[i] = (theta[i] - step).max(parameter.lower);
            beside.push((at(&above)?, at(&below)?, above[i] - below[i]));
        }
        Some(Self { problem, centre, beside })
    }
}

impl Sweep for Simulated<'_> {
    fn columns(&self) -> usize {
        self.beside.len() + self.problem.nuisances()
    }

    fn sweep(&self, segment: &Segment, nuisance: &[f64], visit: &mut dyn FnMut(Step<'_>)) -> bool {
        let (n, m, p) = (self.problem.n(), self.problem.m(), self.problem.p());
        let columns = self.columns();
        let (initial, offsets) = split(self.problem, nuisance);
        let mut state = vec![0.0; n];
        state[..initial.len()].copy_from_slice(initial);
        let ready = |simulator: &Simulator, state: &[f64]| {
            let mut simulator = simulator.clone();
            simulator.set_state(state);
            simulator
        };
        let mut centre = ready(&self.centre, &state);
        let mut beside: Vec<(Simulator, Simulator, f64)> =
            self.beside.iter().map(|(a, b, h)| (ready(a, &state), ready(b, &state), 1.0 / h)).collect();
        for i in 0..initial.len() {
            let (mut above, mut below) = (state.clone(), state.clone());
            above[i] += NUDGE;
            below[i] -= NUDGE;
            beside.push((ready(&self.centre, &above), ready(&self.centre, &below), 0.5 / NUDGE));
        }
        let mut predicted = vec![0.0; p];
        let mut slopes = vec![0.0; p * columns];
        for k in 0..segment.steps {
            let u = &segment.inputs[k * m..(k + 1) * m];
            centre.apply(u);
            predicted.copy_from_slice(centre.measure());
            predicted.iter_mut().zip(offsets).for_each(|(y, o)| *y += o);
            for (column, (above, below, inverse)) in beside.iter_mut().enumerate() {
                above.apply(u);
                below.apply(u);
                for (i, (a, b)) in above.measure().iter().zip(below.measure()).enumerate() {
                    slopes[i * columns + column] = (a - b) * *inverse;
                }
                above.advance();
                below.advance();
            }
            for i in 0..offsets.len() {
                slopes[i * columns + beside.len() + i] = 1.0;
            }
            visit(Step { k, predicted: &predicted, slopes: &slopes });
            centre.advance();
        }
        !centre.diverged() && predicted.iter().all(|y| y.is_finite())
    }
}
