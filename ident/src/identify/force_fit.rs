//! Fits beside forces that wander, and which of them a record shows.

use whirlstand_vehicle::Vehicle;

use super::IdentifyError;
use super::data::Segment;
use super::filter_error;
use super::fitted::{Fit, NoiseFit};
use super::forces::{observable, with_forces};
use super::pem::{Noise, fit, fit_beside};
use super::predictor::{Force, NoiseStructure};
use super::problem::{Parameter, Problem};
use crate::watch::Watch;

/// Key of a vehicle file's provenance that says beside which forces its values were found.
pub const FORCES: &str = "forces";
/// Its value for forces that wander.
pub const WANDERING: &str = "wandering";

/// True for a vehicle whose values were found beside wandering forces, as its provenance says.
pub fn was_found_beside_forces(vehicle: &Vehicle) -> bool {
    vehicle.provenance.iter().any(|(key, value)| key == FORCES && value == WANDERING)
}

/// Names of the states on which a fit found forces.
pub fn pushed_states(fit: &Fit) -> Vec<String> {
    let NoiseFit::Kalman(structure, _) = &fit.noise else { return Vec::new() };
    structure.forces.iter().map(|force| fit.problem.vehicle.states[force.on].name.clone()).collect()
}

/// Fits beside process noise, and beside wandering forces where these are the likelier explanation of the record, by the
/// Bayesian information criterion (Schwarz, Annals of Statistics 6, 1978): the variance of each and its initial value in
/// every segment are further unknowns.
///
/// A force that may be anything also takes what a wrong model leaves of the inputs' effect. So this is for models of which
/// held-out predictions have shown that they are right beside such forces.
///
/// # Errors
/// [`IdentifyError::UnstableStart`].
pub fn fit_beside_likely_forces(
    problem: &Problem,
    segments: &[Segment],
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Result<Fit, IdentifyError> {
    let Ok(plain) = fit(problem, segments, Noise::Kalman, extra, watch) else {
        return fit_beside_forces(problem, segments, extra, watch);
    };
    let forces = if watch.is_stopped() { Vec::new() } else { likely(&plain, segments) };
    if forces.is_empty() {
        return Ok(plain);
    }
    let mut starts = extra.to_vec();
    starts.push(values(problem, &plain));
    let more = forces.len() * (1 + if problem.nuisance.initial_state { segments.len() } else { 0 });
    let structure = NoiseStructure::with_forces(problem, forces);
    let Ok(wide) = fit_beside(problem, segments, structure, &starts, watch) else {
        return Ok(plain);
    };
    let samples = segments.iter().flat_map(|s| &s.outputs).filter(|y| y.is_finite()).count();
    let is_likelier = plain.cost - wide.cost > 0.5 * more as f64 * (samples as f64).ln();
    Ok(if is_likelier { wide } else { plain })
}

/// Fits beside process noise and wandering forces on all states on which one can be told.
///
/// # Errors
/// [`IdentifyError::UnstableStart`].
pub fn fit_beside_forces(
    problem: &Problem,
    segments: &[Segment],
    extra: &[Vec<f64>],
    watch: &Watch,
) -> Result<Fit, IdentifyError> {
    let structure = NoiseStructure::with_forces(problem, observable(problem));
    fit_beside(problem, segments, structure, extra, watch)
}

/// Values of all parameters of a problem as a fit found or fixed them, SI.
fn values(problem: &Problem, fit: &Fit) -> Vec<f64> {
    let found = |p: &Parameter| {
        let free =
            fit.problem.parameters.iter().position(|own| own.target == p.target).map(|at| fit.theta[at]);
        free.or_else(|| fit.fixed.iter().find(|f| f.parameter.target == p.target).map(|f| f.value))
    };
    problem.parameters.iter().map(|p| found(p).unwrap_or(p.lower)).collect()
}

/// Sizes of a force that are tried, as standard deviations relative to the process noise of the state on which it acts,
/// per second: from one that is the larger of the two within a second to one that takes a thousand.
const SIZES: [f64; 4] = [1.0, 0.1, 0.01, 0.001];

/// Gain of the log-likelihood from which a force shows: of one variance, at 5 % (Wilks 1938).
const SHOWS: f64 = 1.92;

/// The observable forces of which some size makes the record likelier than none, at the values of a fit without any. All
/// others can be left out of a fit beside forces.
fn likely(fit: &Fit, segments: &[Segment]) -> Vec<Force> {
    let NoiseFit::Kalman(plain, noise) = &fit.noise else { return Vec::new() };
    let frozen = fit.frozen();
    let Some(without) = filter_error::cost(&frozen, plain, segments, noise) else { return Vec::new() };
    let is_likely = |force: &Force| {
        let structure = NoiseStructure::with_forces(&frozen, vec![*force]);
        let wide = with_forces(&frozen, &structure);
        let Some(at) = plain.states.iter().position(|state| *state == force.on) else { return false };
        SIZES.iter().any(|size| {
            let mut noises = noise.clone();
            noises.insert(plain.states.len(), noise[at] + size.ln());
            filter_error::cost(&wide, &structure, segments, &noises)
                .is_some_and(|cost| cost < without - SHOWS)
        })
    };
    observable(&fit.problem).into_iter().filter(is_likely).collect()
}
