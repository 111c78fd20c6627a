//! Forces that wander: wind, a swinging load, a changing trim.
//!
//! Each is one more state that enters the equation of another and is a random walk, whose variance is estimated like that
//! of all other noise (Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5). In a closed loop the input
//! responds to such a force, so that without its state the input would seem to act with the wrong sign.

use std::borrow::Cow;

use whirlstand_vehicle::{State, Vehicle};

use super::predictor::{Force, NoiseStructure};
use super::problem::Problem;
use super::start::measuring_outputs;

/// The vehicle with an unknown force on some of its states, each a state of its own after the vehicle's.
pub fn pushed(vehicle: &Vehicle, on: impl IntoIterator<Item = usize>) -> Vehicle {
    let (n, on) = (vehicle.states.len(), Vec::from_iter(on));
    let size = n + on.len();
    let mut pushed = vehicle.clone();
    pushed.a.resize_mut(size, size, 0.0);
    pushed.b.resize_mut(size, vehicle.inputs.len(), 0.0);
    pushed.c.resize_mut(vehicle.outputs.len(), size, 0.0);
    for (k, i) in on.into_iter().enumerate() {
        pushed.a[(i, n + k)] = 1.0;
        let state = &vehicle.states[i];
        pushed.states.push(State { name: format!("force on {}", state.name), bound: None, ..state.clone() });
    }
    pushed
}

/// Forces that can be told from the outputs: on states with dynamics that an output measures alone, or whose integral by
/// definition one measures. A force on any other state may be unobservable, and its variance would grow for ever.
pub fn observable(problem: &Problem) -> Vec<Force> {
    let vehicle = &problem.vehicle;
    let measured = measuring_outputs(vehicle, &problem.weights);
    let integral = |j: usize| {
        (0..problem.n())
            .find(|r| vehicle.kinematic_row(*r).is_some_and(|(of, _)| of == j))
            .and_then(|r| measured[r])
    };
    let with_dynamics = (0..problem.n()).filter(|i| vehicle.kinematic_row(*i).is_none());
    let force = |on: usize| Some(Force { on, output: measured[on].or_else(|| integral(on))?.0 });
    with_dynamics.filter_map(force).collect()
}

/// The problem with the forces of the noise as states, after its own.
pub fn with_forces<'a>(problem: &'a Problem, structure: &NoiseStructure) -> Cow<'a, Problem> {
    if structure.forces.is_empty() {
        return Cow::Borrowed(problem);
    }
    let vehicle = pushed(&problem.vehicle, structure.forces.iter().map(|force| force.on));
    Cow::Owned(Problem { vehicle, ..problem.clone() })
}
