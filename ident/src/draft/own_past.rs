//! Test whether inputs explain an output better than its own past: a regression on the past of both against
//! one on the past of the output alone.
//!
//! Both predict a horizon ahead at once, and from the past alone (causality at a horizon: Dufour and Renault,
//! Econometrica 66, 1998, after Granger, Econometrica 37, 1969). Future inputs are not used: in a closed loop
//! they react to the predicted motion, so that they would predict it without causing it, and would hide their
//! effect where they cancel a disturbance. The errors are compared on held-out data (Diebold and Mariano, J.
//! Bus. Econ. Stat. 13, 1995), of which every part of the flight is some in turn (cross-validation: Stone, J. R. Stat. Soc. B
//! 36, 1974): a third of a flight often has too few manoeuvres to tell.

use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dyn};

use crate::identify::Segment;

/// Length of the past in a regression, s, and its fewest and most steps.
const PAST_S: f64 = 0.1;
const LEAST_LAGS: usize = 12;
const MOST_LAGS: usize = 24;

/// Ridge on the diagonal of the normal equations, as a share of it: columns of a smooth signal are nearly
/// collinear.
const RIDGE: f64 = 1e-8;

/// Number of past steps in a regression.
pub fn lags(period_s: f64) -> usize {
    ((PAST_S / period_s).ceil() as usize).clamp(LEAST_LAGS, MOST_LAGS)
}

/// Target of a regression.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ahead {
    /// The output this many steps ahead.
    Output(usize),
    /// The inputs of this many steps, from the next one on.
    Inputs(usize),
}

impl Ahead {
    /// The target values of a segment at step `known`; none where they are beyond its end.
    fn of<'a>(&self, s: &'a Segment, known: usize) -> Option<&'a [f64]> {
        match *self {
            Self::Output(steps) => s.outputs.get(known + steps..=known + steps),
            Self::Inputs(steps) => s.inputs.get(known + 1..=known + steps),
        }
    }

    fn count(&self) -> usize {
        match *self {
            Self::Output(_) => 1,
            Self::Inputs(steps) => steps,
        }
    }
}

/// Normal equations of a regression.
#[derive(Debug, Clone)]
pub struct LeastSquares {
    information: DMatrix<f64>,
    right: DMatrix<f64>,
}

impl LeastSquares {
    /// For `n` regressors and a number of values that they predict.
    fn new(n: usize, values: usize) -> Self {
        Self { information: DMatrix::zeros(n, n), right: DMatrix::zeros(n, values) }
    }

    fn add(&mut self, row: &DVector<f64>, target: &[f64]) {
        self.information.ger(1.0, row, row, 1.0);
        self.right.ger(1.0, row, &DVectorView::from_slice(target, target.len()), 1.0);
    }

    /// Those of both sets of data.
    pub fn with(&self, other: &Self) -> Self {
        Self { information: &self.information + &other.information, right: &self.right + &other.right }
    }

    /// Those of the first regressors.
    pub fn part(&self, regressors: usize) -> Self {
        Self {
            information: self.information.view((0, 0), (regressors, regressors)).into_owned(),
            right: self.right.rows(0, regressors).into_owned(),
        }
    }

    /// Coefficients, one column per predicted value.
    fn solve(self) -> Option<DMatrix<f64>> {
        let right = self.right.clone();
        Some(self.factor()?.solve(&right))
    }

    fn factor(mut self) -> Option<Cholesky<f64, Dyn>> {
        for i in 0..self.information.nrows() {
            // A constant signal gets a coefficient of zero.
            let own = self.information[(i, i)];
            self.information[(i, i)] += (RIDGE * own).max(f64::MIN_POSITIVE.sqrt());
        }
        self.information.cholesky()
    }
}

/// Linear regression of future values on y_k to y_(k-n+1) and u_k to u_(k-m+1).
#[derive(Debug, Clone)]
pub struct Regression {
    outputs: usize,
    inputs: usize,
    /// Coefficients, one column per predicted value.
    coefficients: DMatrix<f64>,
}

impl Regression {
    /// Fits by least squares; `None` where the data are insufficient.
    pub fn fit<'s>(
        segments: impl IntoIterator<Item = &'s Segment>,
        outputs: usize,
        inputs: usize,
        ahead: Ahead,
    ) -> Option<Self> {
        let [equations] = Self::equations(segments, outputs, inputs, &[ahead]).try_into().ok()?;
        Self::solved(outputs, inputs, equations)
    }

    /// Normal equations of regressions on the same past, one for each target, of the steps at which it is known. Products of
    /// the regressors are summed once, and those of the few steps at which a target is missing are taken off again.
    pub fn equations<'s>(
        segments: impl IntoIterator<Item = &'s Segment>,
        outputs: usize,
        inputs: usize,
        ahead: &[Ahead],
    ) -> Vec<LeastSquares> {
        let n = outputs + inputs;
        let past = Self { outputs, inputs, coefficients: DMatrix::zeros(0, 0) };
        let mut all = DMatrix::zeros(n, n);
        let mut equations: Vec<LeastSquares> =
            ahead.iter().map(|a| LeastSquares::new(n, a.count())).collect();
        for s in segments {
            for k in 0..s.steps {
                let known = |a: &Ahead| a.of(s, k).filter(|target| target.iter().all(|v| v.is_finite()));
                if ahead.iter().all(|a| known(a).is_none()) {
                    continue;
                }
                let Some(row) = past.row(s, k) else { continue };
                all.ger(1.0, &row, &row, 1.0);
                for (equations, target) in equations.iter_mut().zip(ahead.iter().map(known)) {
                    match target {
                        Some(target) => equations.right.ger(
                            1.0,
                            &row,
                            &DVectorView::from_slice(target, target.len()),
                            1.0,
                        ),
                        None => equations.information.ger(-1.0, &row, &row, 1.0),
                    }
                }
            }
        }
        equations.iter_mut().for_each(|e| e.information += &all);
        equations
    }

    /// The solution of normal equations; `None` where the data are insufficient.
    pub fn solved(outputs: usize, inputs: usize, equations: LeastSquares) -> Option<Self> {
        Some(Self { outputs, inputs, coefficients: equations.solve()? })
    }

    /// Regressors at step `known`; `None` where the newest value or most of the past is missing.
    fn row(&self, s: &Segment, known: usize) -> Option<DVector<f64>> {
        if known + 1 < self.outputs.max(self.inputs) {
            return None;
        }
        let outputs = past(&s.outputs[..=known], self.outputs)?;
        let inputs = (0..self.inputs).map(|i| s.inputs[known - i]);
        let row = DVector::from_iterator(self.outputs + self.inputs, outputs.into_iter().chain(inputs));
        row.iter().all(|v| v.is_finite()).then_some(row)
    }

    /// Predicted values after step `known`; `None` where a regressor is missing.
    pub fn predict(&self, s: &Segment, known: usize) -> Option<DVector<f64>> {
        Some(self.coefficients.tr_mul(&self.row(s, known)?))
    }
}

/// What a prediction by a regression is worth beside one whose coefficients are known: one over the standard deviation of its
/// error, 1 + h, where the leverage h = x' (X'X)^-1 x counts what the coefficients may be wrong by (Belsley, Kuh and Welsch,
/// Regression Diagnostics, 1980, section 2.1). Where an input moves in one part of a flight only, the other parts do
/// not determine its coefficients, and whatever they are is no evidence against it there.
pub struct Worth {
    past: Regression,
    factor: Cholesky<f64, Dyn>,
}

impl Worth {
    /// Of the regression with these normal equations.
    pub fn of(outputs: usize, inputs: usize, equations: LeastSquares) -> Option<Self> {
        let past = Regression { outputs, inputs, coefficients: DMatrix::zeros(0, 0) };
        Some(Self { past, factor: equations.factor()? })
    }

    /// That of the prediction after step `known`; NaN where a regressor is missing.
    pub fn at(&self, s: &Segment, known: usize) -> f64 {
        let Some(row) = self.past.row(s, known) else { return f64::NAN };
        let leverage = row.dot(&self.factor.solve(&row));
        1.0 / (1.0 + leverage).sqrt()
    }
}

/// Regression of a model's forecast errors on its last innovations: what its noise lacks, a sensor's filter or a longer
/// memory, an autoregression makes good for every model alike (generalised least squares: Clarke, IFAC Symposium on
/// Identification, Prague 1967). Without it a model that knows the inputs could predict worse than an output's own past.
#[derive(Debug, Clone)]
pub struct Memory {
    coefficients: DVector<f64>,
}

impl Memory {
    /// Fits by least squares to forecast errors, each with the innovations up to its last known step; one that is missing is
    /// zero, what is expected of it.
    pub fn fit<'s>(errors: impl IntoIterator<Item = (&'s [f64], f64)>, lags: usize) -> Option<Self> {
        let mut equations = LeastSquares::new(lags, 1);
        for (innovations, error) in errors {
            if error.is_finite() && innovations.len() >= lags {
                equations.add(&last(innovations, lags), &[error]);
            }
        }
        Some(Self { coefficients: equations.solve()?.column(0).into_owned() })
    }

    /// What is left of a forecast error.
    pub fn left(&self, innovations: &[f64], error: f64) -> f64 {
        error - self.coefficients.dot(&last(innovations, self.coefficients.len()))
    }
}

/// The last innovations, the newest first.
fn last(innovations: &[f64], count: usize) -> DVector<f64> {
    let known = |e: &f64| if e.is_finite() { *e } else { 0.0 };
    DVector::from_iterator(count, innovations.iter().rev().take(count).map(known))
}

/// The last `count` values, the newest first. Missing ones are interpolated between their neighbours, of which none is newer
/// than the last: a lost sample must not cost all predictions whose past it is part of. `None` where the last value or more
/// than half of them are missing.
fn past(values: &[f64], count: usize) -> Option<Vec<f64>> {
    let mut found: Vec<f64> = Vec::with_capacity(count);
    let (mut newer, mut missing) = ((0, *values.last()?), 0);
    for i in 0..count {
        let value = values[values.len() - 1 - i];
        if value.is_finite() {
            newer = (i, value);
            found.push(value);
            continue;
        }
        missing += 1;
        let older =
            (i + 1..values.len()).map(|j| (j, values[values.len() - 1 - j])).find(|(_, v)| v.is_finite());
        let (j, value) = older.unwrap_or((i + 1, newer.1));
        let share = (i - newer.0) as f64 / (j - newer.0) as f64;
        found.push(newer.1 + share * (value - newer.1));
    }
    (2 * missing <= count).then_some(found)
}

/// Start steps of predictions in a segment, two per horizon, after `warm` steps in which a filter settles.
pub fn starts(segment: &Segment, warm: usize, horizon: usize) -> Vec<usize> {
    (warm..segment.steps.saturating_sub(horizon)).step_by((horizon / 2).max(1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draft::comparison::{Comparison, compare};
    use whirlstand_test_harness::noise;

    /// A first-order motion driven by an input and by noise, or by noise alone.
    fn flight(gain: f64, seed: u64) -> Segment {
        let steps = 3000;
        let (e, v) = (noise(steps, seed), noise(steps, seed + 1));
        let (mut y, mut u) = (0.0, 0.0);
        let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
        for k in 0..steps {
            outputs.push(y);
            // The input reacts to the output, as in a closed loop.
            u = 0.9 * u + 0.3 * v[k] - 0.1 * y;
            inputs.push(u);
            y = 0.95 * y + gain * u + 0.05 * e[k];
        }
        Segment { origin: "x".into(), start_s: 0.0, first_step: 0, period_s: 0.01, inputs, outputs, steps }
    }

    /// The coefficients of an input that hardly moved are not known, and a prediction with them where it moves is worth little.
    #[test]
    fn a_prediction_beyond_what_the_fit_has_seen_is_worth_little() {
        let usual = flight(0.1, 1);
        let mut still = usual.clone();
        still.inputs.iter_mut().for_each(|u| *u = 0.2 + 1e-3 * *u);
        let worth = |fitted: &Segment| {
            let equations = Regression::equations([fitted], 12, 12, &[Ahead::Output(10)]).remove(0);
            let worth = Worth::of(12, 12, equations).unwrap();
            let at: Vec<f64> = starts(&usual, 24, 10).into_iter().map(|k| worth.at(&usual, k)).collect();
            at.iter().sum::<f64>() / at.len() as f64
        };
        assert!(worth(&usual) > 0.9 && worth(&still) < 0.2, "{} {}", worth(&usual), worth(&still));
    }

    fn compared(gain: f64) -> Comparison {
        let (fitted, held) = ([flight(gain, 1)], flight(gain, 5));
        let errors = |inputs| {
            let found = Regression::fit(&fitted, 12, inputs, Ahead::Output(10)).unwrap();
            let error = |k: usize| held.outputs[k + 10] - found.predict(&held, k).unwrap()[0];
            starts(&held, 24, 10).into_iter().map(error).collect::<Vec<_>>()
        };
        compare(&errors(0), &errors(12)).unwrap()
    }

    #[test]
    fn lost_values_of_the_past_lie_between_their_neighbours() {
        let nan = f64::NAN;
        assert_eq!(past(&[9.0, 1.0, nan, nan, 4.0], 4), Some(vec![4.0, 3.0, 2.0, 1.0]));
        // The neighbour may be older than the past that is asked for.
        assert_eq!(past(&[0.0, nan, 2.0, 3.0], 3), Some(vec![3.0, 2.0, 1.0]));
        assert_eq!(past(&[nan, nan, 2.0, 3.0], 3), Some(vec![3.0, 2.0, 2.0]));
        assert_eq!(past(&[0.0, nan, nan, 3.0], 3), None, "most of it is unknown");
        assert!(past(&[0.0, 1.0, nan], 2).is_none_or(|p| p.iter().any(|v| v.is_nan())), "the newest is");
    }

    #[test]
    fn an_input_that_acts_is_told_from_one_that_only_reacts() {
        let acts = compared(0.1);
        assert!(acts.sigmas > 4.0 && acts.second < 0.8 * acts.first, "{acts:?}");
        let reacts = compared(0.0);
        assert!(reacts.sigmas < 3.0, "{reacts:?}");
    }
}
