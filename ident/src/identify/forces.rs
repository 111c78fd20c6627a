//! Forces that wander: wind, a swinging load, a changing trim.
//!
//! Each is one more state that enters the equation of another and is a random walk, whose variance is estimated like that
//! of all other noise (Jategaonkar, Flight Vehicle System Identification, 2nd ed., chapter 5). In a closed loop the input
//! responds to such a force, so that without its state the input would seem to act with the wrong sign.

use std::borrow::Cow;

use whirlstand_vehicle::{SignalUnit, State};

use super::data::Segment;
use super::filter_error;
use super::fitted::{Fit, NoiseFit};
use super::predictor::NoiseStructure;
use super::problem::Problem;
use super::start::measuring_outputs;

/// Key of a vehicle file's provenance that says beside which forces its values were found.
pub const FORCES: &str = "forces";
/// Its value for forces that wander.
pub const WANDERING: &str = "wandering";

/// States with dynamics on which a force can be told from the outputs: those that an output measures alone, or whose
/// integral by definition one measures; each with such an output. The force on any other state may be unobservable, and its
/// variance would grow for ever.
pub fn observable(problem: &Problem) -> Vec<(usize, usize)> {
    let vehicle = &problem.vehicle;
    let measured = measuring_outputs(vehicle, &problem.weights);
    let integral = |j: usize| {
        (0..problem.n())
            .find(|r| vehicle.kinematic_row(*r).is_some_and(|(of, _)| of == j))
            .and_then(|r| measured[r])
    };
    let with_dynamics = (0..problem.n()).filter(|i| vehicle.kinematic_row(*i).is_none());
    with_dynamics.filter_map(|i| Some((i, measured[i].or_else(|| integral(i))?.0))).collect()
}

/// The problem with the forces of the noise as states, after its own.
pub fn with_forces<'a>(problem: &'a Problem, structure: &NoiseStructure) -> Cow<'a, Problem> {
    if structure.forces.is_empty() {
        return Cow::Borrowed(problem);
    }
    let mut wide = problem.clone();
    let vehicle = &mut wide.vehicle;
    let (own, n) = (problem.n(), problem.n() + structure.forces.len());
    vehicle.a.resize_mut(n, n, 0.0);
    vehicle.b.resize_mut(n, problem.m(), 0.0);
    vehicle.c.resize_mut(problem.p(), n, 0.0);
    for (k, (on, _)) in structure.forces.iter().enumerate() {
        vehicle.a[(*on, own + k)] = 1.0;
        let name = format!("force on {}", vehicle.states[*on].name);
        vehicle.states.push(State { name, unit: SignalUnit::default(), bound: None });
    }
    Cow::Owned(wide)
}

/// Sizes of a force that are tried, as standard deviations relative to the process noise of the state on which it acts,
/// per second: from one that is the larger of the two within a second to one that takes a thousand.
const SIZES: [f64; 4] = [1.0, 0.1, 0.01, 0.001];

/// Gain of the log-likelihood from which a force shows: of one variance, at 5 % (Wilks 1938).
const SHOWS: f64 = 1.92;

/// The observable forces of which some size makes the record likelier than none, at the values of a fit without any. All
/// others can be left out of a fit beside forces.
pub fn likely(fit: &Fit, segments: &[Segment]) -> Vec<(usize, usize)> {
    let NoiseFit::Kalman(plain, noise) = &fit.noise else { return Vec::new() };
    let frozen = fit.frozen();
    let Some(without) = filter_error::cost(&frozen, plain, segments, noise) else { return Vec::new() };
    let is_likely = |force: &(usize, usize)| {
        let structure = NoiseStructure::with_forces(&frozen, vec![*force]);
        let wide = with_forces(&frozen, &structure);
        let Some(at) = plain.states.iter().position(|state| *state == force.0) else { return false };
        SIZES.iter().any(|size| {
            let mut noises = noise.clone();
            noises.insert(plain.states.len(), noise[at] + size.ln());
            filter_error::cost(&wide, &structure, segments, &noises)
                .is_some_and(|cost| cost < without - SHOWS)
        })
    };
    observable(&fit.problem).into_iter().filter(is_likely).collect()
}
