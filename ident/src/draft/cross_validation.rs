//! Predictions of an output from its past, with and without an input, on each part of the flight by what the others show.

use super::blocks::{Pair, warm};
use super::comparison::{Comparison, compare};
use super::own_past::{Ahead, LeastSquares, Regression, Worth, lags, starts};
use crate::identify::Segment;

/// Regressions of one pair at several horizons: their normal equations for each part of the flight. Those of all horizons and
/// of the output's past alone have their sums of products in common.
pub struct Parts<'p> {
    pair: &'p Pair,
    horizons: &'p [usize],
    equations: Vec<Vec<LeastSquares>>,
}

impl<'p> Parts<'p> {
    /// Normal equations at these horizons, steps.
    pub fn of(pair: &'p Pair, horizons: &'p [usize]) -> Self {
        let (lags, ahead) =
            (lags(pair.period_s), horizons.iter().map(|h| Ahead::Output(*h)).collect::<Vec<_>>());
        let equations =
            pair.folds.iter().map(|fold| Regression::equations(fold, lags, lags, &ahead)).collect();
        Self { pair, horizons, equations }
    }

    /// Errors at one of the horizons on one part of the flight, of the regression on inputs and past, or on the past alone.
    /// Where the mean predicts better than the latter, the errors are those of the mean. `None` where the data are
    /// insufficient.
    pub fn errors(&self, part: usize, at: usize, with_input: bool) -> Option<Vec<f64>> {
        let (pair, horizon, lags) = (self.pair, self.horizons[at], lags(self.pair.period_s));
        let inputs = if with_input { lags } else { 0 };
        let others = self.others(part, at)?;
        let found = Regression::solved(lags, inputs, others.part(lags + inputs))?;
        let from = |s: &Segment| starts(s, warm(pair, horizon), horizon);
        let error = |s: &Segment, k: usize| {
            found.predict(s, k).map_or(f64::NAN, |predicted| s.outputs[k + horizon] - predicted[0])
        };
        let held = &pair.folds[part];
        let errors: Vec<f64> =
            held.iter().flat_map(|s| from(s).into_iter().map(move |k| error(s, k))).collect();
        if with_input {
            return Some(errors);
        }
        let level = |s: &Segment| from(s).into_iter().map(|k| s.outputs[k + horizon]).collect::<Vec<_>>();
        let of_mean: Vec<f64> = held.iter().flat_map(level).collect();
        let worse = compare(&errors, &of_mean).is_some_and(|c| c.first > c.second);
        Some(if worse { of_mean } else { errors })
    }

    /// Normal equations of the other parts together.
    fn others(&self, part: usize, at: usize) -> Option<LeastSquares> {
        let others =
            self.equations.iter().enumerate().filter(|(other, _)| *other != part).map(|(_, e)| &e[at]);
        others.cloned().reduce(|a, b| a.with(&b))
    }

    /// Comparison at one of the horizons of the predictions from the past alone with those from past and input, on all parts,
    /// each error weighed by what the prediction with the input is worth there.
    pub fn compared(&self, at: usize) -> Option<Comparison> {
        let parts = 0..self.pair.folds.len();
        let worth = parts.clone().map(|part| self.worth(part, at)).collect::<Option<Vec<_>>>()?.concat();
        let weighed = |with_input: bool| -> Option<Vec<f64>> {
            let errors = parts.clone().map(|part| self.errors(part, at, with_input));
            let errors = errors.collect::<Option<Vec<_>>>()?.concat();
            Some(errors.into_iter().zip(&worth).map(|(error, worth)| error * worth).collect())
        };
        compare(&weighed(false)?, &weighed(true)?)
    }

    fn worth(&self, part: usize, at: usize) -> Option<Vec<f64>> {
        let (pair, horizon, lags) = (self.pair, self.horizons[at], lags(self.pair.period_s));
        let worth = Worth::of(lags, lags, self.others(part, at)?)?;
        let of = |s: &Segment| {
            starts(s, warm(pair, horizon), horizon).into_iter().map(|k| worth.at(s, k)).collect::<Vec<_>>()
        };
        Some(pair.folds[part].iter().flat_map(of).collect())
    }
}
