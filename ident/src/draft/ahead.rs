//! Predictions of a fitted model over a horizon: a filter follows the record, and the model is simulated from
//! its state.
//!
//! The inputs over the horizon are predicted from the past as well. With the recorded inputs, the best model
//! of a vehicle in a closed loop would predict worse than no model at all: they contain the response to
//! future disturbances that the model cannot know. As the model is linear, the expected inputs give the
//! expected output.

use whirlstand_vehicle::Simulator;

use super::own_past::Regression;
use crate::identify::Segment;
use crate::identify::fitted::{Fit, NoiseFit};
use crate::identify::forces::with_forces;
use crate::identify::predictor::{Gains, Pattern};

/// Forecasts over the steps that `inputs` predicts for a segment of one input and one output, one from each of `starts`, the last known
/// steps, NaN where a value is missing; and the innovation of every step. `None` when the filter has no steady state.
pub fn forecasts(
    fit: &Fit,
    inputs: &Regression,
    segment: &Segment,
    starts: &[usize],
) -> Option<(Vec<f64>, Vec<f64>)> {
    let NoiseFit::Kalman(structure, noise) = &fit.noise else { return None };
    let own = fit.frozen();
    let problem = with_forces(&own, structure);
    let pattern = Pattern::of(segment, 1);
    let gains = Gains::new(&problem, structure, &pattern, &[], noise, false)?;
    let mut simulator = Simulator::expected(&problem.vehicle, segment.period_s).ok()?;
    simulator.begin_at(segment.first_step);
    let mut change = vec![0.0; problem.n()];
    let mut forecasts = Vec::with_capacity(starts.len());
    let mut innovations = Vec::with_capacity(segment.steps);
    for k in 0..segment.steps {
        simulator.apply(&segment.inputs[k..=k]);
        let predicted = [simulator.measure()[0]];
        innovations.push(segment.outputs[k] - predicted[0]);
        simulator.advance();
        gains.change(k, &segment.outputs[k..=k], &predicted, None, &mut change);
        simulator.correct(&change);
        if starts.binary_search(&k).is_ok() {
            let expected = inputs.predict(segment, k);
            forecasts.push(
                expected.map_or(f64::NAN, |expected| run_ahead(simulator.clone(), expected.as_slice())),
            );
        }
    }
    Some((forecasts, innovations))
}

/// Output at the last step of the given inputs, from a simulator that stands at the first.
fn run_ahead(mut simulator: Simulator, inputs: &[f64]) -> f64 {
    for (k, _) in inputs.iter().enumerate() {
        if k > 0 {
            simulator.advance();
        }
        simulator.apply(&inputs[k..=k]);
    }
    simulator.measure()[0]
}
