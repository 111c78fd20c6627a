//! Predictions of a fitted model at a horizon: the filter follows the record, and from it the model runs ahead.

use whirlstand_vehicle::Simulator;

use crate::identify::Segment;
use crate::identify::fitted::{Fit, NoiseFit};
use crate::identify::predictor::{Gains, Pattern};

/// Errors of predictions `horizon` steps ahead of a segment of one input and one output, one from each of `starts`,
/// which are the last steps that are known; NaN where a value is missing. `None` when the filter has no steady state.
pub fn errors(fit: &Fit, segment: &Segment, starts: &[usize], horizon: usize) -> Option<Vec<f64>> {
    let NoiseFit::Kalman(structure, noise) = &fit.noise else { return None };
    let mut problem = fit.problem.clone();
    problem.vehicle = fit.problem.vehicle_at(&fit.theta);
    problem.parameters.clear();
    let pattern = Pattern::of(segment, 1);
    let gains = Gains::new(&problem, structure, &pattern, &[], noise, false)?;
    let mut simulator = Simulator::expected(&problem.vehicle, segment.period_s).ok()?;
    let mut change = vec![0.0; problem.n()];
    let mut errors = Vec::with_capacity(starts.len());
    for k in 0..segment.steps {
        simulator.apply(&segment.inputs[k..=k]);
        let predicted = [simulator.measure()[0]];
        simulator.advance();
        gains.change(k, &segment.outputs[k..=k], &predicted, None, &mut change);
        simulator.correct(&change);
        if starts.binary_search(&k).is_ok() {
            errors.push(run_ahead(simulator.clone(), segment, k, horizon));
        }
    }
    Some(errors)
}

/// The error at step `known + horizon` of a simulator that stands one step after `known`.
fn run_ahead(mut simulator: Simulator, segment: &Segment, known: usize, horizon: usize) -> f64 {
    for k in known + 1..known + horizon {
        if k < segment.steps {
            simulator.apply(&segment.inputs[k..=k]);
            simulator.advance();
        }
    }
    let at = known + horizon;
    if at >= segment.steps {
        return f64::NAN;
    }
    simulator.apply(&segment.inputs[at..=at]);
    segment.outputs[at] - simulator.measure()[0]
}
