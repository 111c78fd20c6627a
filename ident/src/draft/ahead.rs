//! Predictions of a fitted model over a horizon: a filter follows the record, and the model is simulated from
//! its state.
//!
//! In a closed loop the inputs over the horizon are predicted from the past as well. With the recorded inputs, the best model
//! of a vehicle would predict worse than no model at all: they contain the response to future disturbances that the model
//! cannot know. As the model is linear, the expected inputs give the expected output.

use nalgebra::{DMatrix, DVector};
use whirlstand_logs::stats::mean;
use whirlstand_vehicle::Simulator;

use super::own_past::Regression;
use crate::identify::Segment;
use crate::identify::fitted::{Fit, NoiseFit};
use crate::identify::forces::with_forces;
use crate::identify::predictor::{Gains, Pattern};
use crate::identify::problem::Problem;

/// What is known of the input in forecasts.
pub struct Inputs<'r> {
    /// Number of steps.
    pub steps: usize,
    /// Expects the inputs; `None` for the recorded ones.
    pub expected: Option<&'r Regression>,
}

impl Inputs<'_> {
    /// The inputs of the steps after `known`, as far as the segment goes.
    fn next(&self, segment: &Segment, known: usize) -> Option<Vec<f64>> {
        match self.expected {
            Some(expected) => Some(expected.predict(segment, known)?.iter().copied().collect()),
            None => segment.inputs.get(known + 1..=known + self.steps).map(<[f64]>::to_vec),
        }
    }
}

/// Forecasts for a segment of one input and one output, one from each of `starts`, the last known steps, NaN where a value is
/// missing; and the innovation of every step. What the segment begins with is found on the way ([`Beginning`]). `None` when
/// the filter has no steady state.
pub fn forecasts(
    fit: &Fit,
    inputs: &Inputs<'_>,
    segment: &Segment,
    starts: &[usize],
) -> Option<(Vec<f64>, Vec<f64>)> {
    let NoiseFit::Kalman(structure, noise) = &fit.noise else { return None };
    let problem = with_forces(&fit.frozen(), structure).into_owned();
    let pattern = Pattern::of(segment, 1);
    let gains = Gains::new(&problem, structure, &pattern, &[], noise, false)?;
    let mut beginning = Beginning::of(fit, &problem, segment)?;
    let mut forecasts = Vec::with_capacity(starts.len());
    let mut innovations = Vec::with_capacity(segment.steps);
    for k in 0..segment.steps {
        innovations.push(beginning.follow(&gains, segment, k));
        if starts.binary_search(&k).is_ok() {
            let next = inputs.next(segment, k);
            forecasts.push(next.map_or(f64::NAN, |next| run_ahead(beginning.found(), &next)));
        }
    }
    Some((forecasts, innovations))
}

/// The filter's state at the first step of a segment, as an unknown: with little process noise a filter in its steady state
/// would hardly find it. As the model is linear, one more filter for each state tells what its beginning does to every later
/// innovation, and those so far tell the beginning by least squares (de Jong, The diffuse Kalman filter, Annals of Statistics
/// 19, 1991), beside what the fitted segments began with.
struct Beginning {
    /// The filter that begins where it is expected to, and those that begin one unit further in each state.
    filters: Vec<Simulator>,
    /// Normal equations of the distance from where it was expected to begin.
    information: DMatrix<f64>,
    right: DVector<f64>,
}

impl Beginning {
    /// Expects the first known output, and the mean of the forces with which the fitted segments begin; how far from it a
    /// segment may begin is how far the fitted ones do.
    fn of(fit: &Fit, problem: &Problem, segment: &Segment) -> Option<Self> {
        let (n, own) = (problem.n(), fit.problem.n());
        let begun = |state: usize| fit.nuisances.iter().filter_map(move |of| of.get(state).copied());
        // The first state of every structure is the output, the others are its slope, and forces.
        let first = segment.outputs.iter().copied().find(|y| y.is_finite()).unwrap_or(0.0);
        let expected: Vec<f64> = (0..n)
            .map(|state| match state {
                0 => first,
                state if state < own => 0.0,
                state => mean(&begun(state).collect::<Vec<_>>()),
            })
            .collect();
        let mut filter =
            Simulator::expected_from(&problem.vehicle, segment.period_s, &segment.inputs[..1]).ok()?;
        filter.begin_at(segment.first_step);
        filter.set_state(&expected);
        let mut filters = vec![filter.clone()];
        let mut spreads = Vec::with_capacity(n);
        for state in 0..n {
            let level = if state < own { 0.0 } else { expected[state] };
            spreads.push(mean_square(begun(state).map(|v| v - level)));
            let mut moved = expected.clone();
            moved[state] += 1.0;
            filter.set_state(&moved);
            filters.push(filter.clone());
        }
        let known = spreads.iter().map(|spread| 1.0 / spread.max(f64::MIN_POSITIVE.sqrt()));
        let information = DMatrix::from_diagonal(&DVector::from_iterator(n, known));
        Some(Self { filters, information, right: DVector::zeros(n) })
    }

    /// Advances all filters by step `k`; returns the innovation, of what was known before it.
    fn follow(&mut self, gains: &Gains, segment: &Segment, k: usize) -> f64 {
        let (measured, n) = (&segment.outputs[k..=k], self.right.len());
        let mut change = vec![0.0; n];
        let mut predicted = Vec::with_capacity(n + 1);
        for filter in &mut self.filters {
            filter.apply(&segment.inputs[k..=k]);
            let output = [filter.measure()[0]];
            filter.advance();
            gains.change(k, measured, &output, None, &mut change);
            filter.correct(&change);
            predicted.push(output[0]);
        }
        let effects = DVector::from_fn(n, |i, _| predicted[i + 1] - predicted[0]);
        let error = measured[0] - predicted[0];
        let innovation = error - effects.dot(&self.distance());
        let phase = gains.phase(k);
        if error.is_finite() && !phase.fresh.is_empty() {
            let weight = 1.0 / phase.covariance[(0, 0)];
            self.information.ger(weight, &effects, &effects, 1.0);
            self.right.axpy(weight * error, &effects, 1.0);
        }
        innovation
    }

    /// How far from where it was expected the segment began, as far as is known.
    fn distance(&self) -> DVector<f64> {
        let solved = self.information.clone().cholesky().map(|c| c.solve(&self.right));
        solved.unwrap_or_else(|| DVector::zeros(self.right.len()))
    }

    /// The filter that began where the segment did, as far as is known.
    fn found(&self) -> Simulator {
        let mut filter = self.filters[0].clone();
        let mut change = vec![0.0; filter.state().len()];
        for (moved, by) in self.filters[1..].iter().zip(self.distance().iter()) {
            for ((change, moved), own) in change.iter_mut().zip(moved.state()).zip(filter.state()) {
                *change += by * (moved - own);
            }
        }
        filter.correct(&change);
        filter
    }
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

fn mean_square(values: impl Iterator<Item = f64>) -> f64 {
    mean(&values.map(|v| v * v).collect::<Vec<_>>())
}
