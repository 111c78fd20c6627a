//! Predictions of a fitted model at a horizon: the filter follows the record, and from it the model runs ahead.
//!
//! The inputs until then are predicted from the past as well. With those of the record the best model of a vehicle in a
//! closed loop would predict worse than no model at all: they hold the answer to disturbances that are yet to come, and
//! that the model cannot know. The model is linear, so that with the expected inputs it gives the expected output.

use whirlstand_vehicle::Simulator;

use super::own_past::Regression;
use crate::identify::Segment;
use crate::identify::fitted::{Fit, NoiseFit};
use crate::identify::predictor::{Gains, Pattern};

/// Errors of predictions `horizon` steps ahead of a segment of one input and one output, one from each of `starts`,
/// which are the last steps that are known; NaN where a value is missing. `None` when the filter has no steady state.
pub fn errors(
    fit: &Fit,
    inputs: &Regression,
    segment: &Segment,
    starts: &[usize],
    horizon: usize,
) -> Option<Vec<f64>> {
    let NoiseFit::Kalman(structure, noise) = &fit.noise else { return None };
    let mut problem = fit.problem.clone();
    problem.vehicle = fit.problem.vehicle_at(&fit.theta);
    problem.parameters.clear();
    let pattern = Pattern::of(segment, 1);
    let gains = Gains::new(&problem, structure, &pattern, &[], noise, false)?;
    let mut simulator = Simulator::expected(&problem.vehicle, segment.period_s).ok()?;
    simulator.begin_at(segment.first_step);
    let mut change = vec![0.0; problem.n()];
    let mut errors = Vec::with_capacity(starts.len());
    for k in 0..segment.steps {
        simulator.apply(&segment.inputs[k..=k]);
        let predicted = [simulator.measure()[0]];
        simulator.advance();
        gains.change(k, &segment.outputs[k..=k], &predicted, None, &mut change);
        simulator.correct(&change);
        if starts.binary_search(&k).is_ok() {
            let expected = inputs.predict(segment, k);
            errors.push(expected.map_or(f64::NAN, |expected| {
                segment.outputs[k + horizon] - run_ahead(simulator.clone(), expected.as_slice())
            }));
        }
    }
    Some(errors)
}

/// The output at the last of the steps that these inputs are of, from a simulator that stands at the first.
fn run_ahead(mut simulator: Simulator, inputs: &[f64]) -> f64 {
    for (k, _) in inputs.iter().enumerate() {
        if k > 0 {
            simulator.advance();
        }
        simulator.apply(&inputs[k..=k]);
    }
    simulator.measure()[0]
}
