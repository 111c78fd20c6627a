//! Predictions of a fitted model over a horizon: a filter follows the record, and the model is simulated from
//! its state.
//!
//! In a closed loop the inputs over the horizon are predicted from the past as well. With the recorded inputs, the best model
//! of a vehicle would predict worse than no model at all: they contain the response to future disturbances that the model
//! cannot know. As the model is linear, the expected inputs give the expected output.

use whirlstand_logs::stats::mean;
use whirlstand_vehicle::Simulator;

use super::own_past::Regression;
use crate::identify::Segment;
use crate::identify::fitted::{Fit, NoiseFit};
use crate::identify::forces::with_forces;
use crate::identify::predictor::{Gains, Pattern};

/// The inputs of the future in a forecast.
pub struct Future<'r> {
    /// Number of steps.
    pub steps: usize,
    /// Expects the inputs; `None` for the recorded ones.
    pub expected: Option<&'r Regression>,
}

impl Future<'_> {
    /// The inputs of the steps after `known`, as far as the segment goes.
    fn inputs(&self, segment: &Segment, known: usize) -> Option<Vec<f64>> {
        match self.expected {
            Some(expected) => Some(expected.predict(segment, known)?.iter().copied().collect()),
            None => segment.inputs.get(known + 1..=known + self.steps).map(<[f64]>::to_vec),
        }
    }
}

/// Forecasts for a segment of one input and one output, one from each of `starts`, the last known steps, NaN where a value is
/// missing; and the innovation of every step. The filter begins at the first known output, and at the mean of the forces with
/// which the fitted segments begin: without process noise it would hardly find either. `None` when the filter has no steady state.
pub fn forecasts(
    fit: &Fit,
    future: &Future<'_>,
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
    // The first state of every structure is the output.
    let mut begun = vec![0.0; problem.n()];
    begun[0] = segment.outputs.iter().copied().find(|y| y.is_finite()).unwrap_or(0.0);
    for (state, begun) in begun.iter_mut().enumerate().skip(own.n()) {
        *begun = mean(&fit.nuisances.iter().filter_map(|n| n.get(state).copied()).collect::<Vec<_>>());
    }
    simulator.set_state(&begun);
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
            let inputs = future.inputs(segment, k);
            forecasts.push(inputs.map_or(f64::NAN, |inputs| run_ahead(simulator.clone(), &inputs)));
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
