//! Selects the simulation method of a problem: recursions where the vehicle is linear behind its inputs, else the simulator.

use super::linear::Linear;
use super::predictor::Gains;
use super::problem::{Problem, Sweep};
use super::simulated::Simulated;

/// The simulation at `theta`. `None` when its discretisation is not finite.
pub fn simulation<'p>(problem: &'p Problem, theta: &[f64]) -> Option<Box<dyn Sweep + 'p>> {
    with(problem, theta, None)
}

/// The one-step predictor at `theta` with the filter `gains` computed there. `None` when its discretisation
/// is not finite.
pub fn predictor<'p>(problem: &'p Problem, theta: &[f64], gains: &'p Gains) -> Option<Box<dyn Sweep + 'p>> {
    with(problem, theta, Some(gains))
}

fn with<'p>(problem: &'p Problem, theta: &[f64], gains: Option<&'p Gains>) -> Option<Box<dyn Sweep + 'p>> {
    if let Some(linear) = Linear::new(problem, theta, gains) {
        return Some(Box::new(linear));
    }
    Some(Box::new(Simulated::new(problem, theta, gains)?))
}
