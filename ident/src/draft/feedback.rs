//! Test whether an input reacts to an output.
//!
//! In a closed loop the inputs of the future contain the answer to disturbances that no model knows, so that a forecast with
//! them says nothing about the model (Ljung, System Identification, 2nd ed., section 13.4). Where the past of the output adds
//! nothing to what the input's own past says about the input (Granger, Econometrica 37, 1969), nothing reacts: the recorded
//! inputs may then be used, which tell models apart far better than inputs that are guessed.

use super::blocks::{Pair, warm};
use super::comparison::compare;
use super::own_past::{Ahead, Regression, lags, starts};
use crate::identify::Segment;
use whirlstand_logs::stats::rms;

/// Standard errors from which an input counts as one that reacts. Low, as a loop that is taken for open costs more than one
/// that is taken for closed.
const REACTS_SIGMAS: f64 = 1.0;
/// Error with which an input's own past predicts it, as a share of its spread, below which nothing is left that could be a
/// reaction: a sum of sines is known for ever, and the rounding that remains belongs to nobody.
const KNOWN_SHARE: f64 = 0.01;

/// True when the past of the output helps to predict the input over the horizon, on all parts of the flight, each predicted
/// from the other two; also where the data do not suffice to tell.
pub fn reacts(pair: &Pair, horizon: usize) -> bool {
    let errors = |outputs: usize| -> Option<Vec<f64>> {
        let one = |fold: usize| errors_of_fold(pair, fold, horizon, outputs);
        Some((0..pair.folds.len()).map(one).collect::<Option<Vec<_>>>()?.concat())
    };
    let (alone, with_output) = (errors(0), errors(lags(pair.period_s)));
    match alone.zip(with_output).and_then(|(alone, with)| compare(&alone, &with)) {
        Some(comparison) => {
            let is_known = comparison.first.sqrt() < KNOWN_SHARE * pair.input_spread;
            comparison.sigmas > REACTS_SIGMAS && !is_known
        }
        None => true,
    }
}

/// Root mean square error of the input over the horizon, from every start in one part of the flight.
fn errors_of_fold(pair: &Pair, fold: usize, horizon: usize, outputs: usize) -> Option<Vec<f64>> {
    let others = pair.folds.iter().enumerate().filter(|(other, _)| *other != fold).flat_map(|(_, f)| f);
    let found = Regression::fit(others, outputs, lags(pair.period_s), Ahead::Inputs(horizon))?;
    let error = |s: &Segment, k: usize| {
        let Some(predicted) = found.predict(s, k) else { return f64::NAN };
        let missed = s.inputs[k + 1..=k + horizon].iter().zip(predicted.iter()).map(|(u, p)| u - p);
        rms(&missed.collect::<Vec<_>>())
    };
    let of = |s: &Segment| starts(s, warm(pair, horizon), horizon).into_iter().map(|k| error(s, k)).collect();
    Some(pair.folds[fold].iter().flat_map(|s| -> Vec<f64> { of(s) }).collect())
}
