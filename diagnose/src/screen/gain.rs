//! Scale of a record's columns relative to the vehicle: estimated factors with intervals.
//!
//! The innovations of a filter are linear in the factors of the columns, and their likelihood contains the
//! derivative of the innovations by the measured values (Ljung 1999, 7.4): without it, a factor of zero would
//! be the best.

use nalgebra::DMatrix;
use whirlstand_ident::identify::ar::Ar;
use whirlstand_logs::stats::mean;

use super::responses::Responses;
use crate::model::columns::dot;
use crate::model::noise::filtered;
use crate::thresholds::{DECLARED_NOISE_LOG_STD, FACTOR_SIGMAS, GREATEST_FACTOR, SCREENED_AR_ORDER};

/// Relative rounding error of a difference of two sums of squares.
const ROUNDING: f64 = 1e-13;

/// The columns of every channel without their means, and the noise that the vehicle declares.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    channels: Vec<Vec<Vec<f64>>>,
    declared: Vec<f64>,
}

impl Columns {
    /// `declared` are the channels' standard deviations, 0 where the vehicle declares none.
    pub fn new(responses: &Responses, declared: Vec<f64>) -> Self {
        let level = |columns: &Vec<Vec<f64>>| columns.iter().map(|c| about_mean(c)).collect();
        Self { channels: responses.channels.iter().map(level).collect(), declared }
    }

    /// Number of columns of each channel.
    pub fn sources(&self) -> usize {
        self.channels.first().map_or(0, Vec::len)
    }

    /// Weighted sum of a channel's columns, and its noise model.
    fn residual(columns: &[Vec<f64>], weights: &[f64]) -> (Vec<f64>, Ar) {
        let mut residual = vec![0.0; columns.first().map_or(0, Vec::len)];
        for (column, weight) in columns.iter().zip(weights) {
            residual.iter_mut().zip(column).for_each(|(r, c)| *r += weight * c);
        }
        let ar = Ar::fit(&[&residual], SCREENED_AR_ORDER);
        (residual, ar)
    }

    /// Log-likelihood of weights, without constants, each with a noise model of its own; and the log-prior of
    /// the noise's size, whose logarithm is normally distributed about the declared value.
    pub fn likelihood(&self, weights: &[f64]) -> (f64, f64) {
        let (mut all, mut prior) = (0.0, 0.0);
        for (i, (columns, declared)) in self.channels.iter().zip(&self.declared).enumerate() {
            let (residual, ar) = Self::residual(columns, weights);
            let size = columns.iter().zip(weights).map(|(c, w)| w * w * dot(c, c)).fold(0.0, f64::max);
            let rows = residual.len() as f64;
            let variance = ar.variance.max(ROUNDING * size / rows.max(1.0)).max(f64::MIN_POSITIVE);
            all += rows * (weights[i].abs().ln() - 0.5 * variance.ln());
            if *declared > 0.0 {
                prior -= 0.5 * ((variance.sqrt() / declared).ln() / DECLARED_NOISE_LOG_STD).powi(2);
            }
        }
        (all, prior)
    }
}

/// Inner products of one channel's columns.
#[derive(Debug, Clone)]
struct Products {
    products: DMatrix<f64>,
    /// Number of rows that count.
    rows: f64,
}

/// Likelihood of the factors under a given noise model.
#[derive(Debug, Clone)]
struct FactorLikelihood {
    channels: Vec<Products>,
}

/// An estimated common factor of several columns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Factor {
    /// Logarithm of the estimate.
    pub log: f64,
    /// Half width of the interval of the logarithm.
    pub half: f64,
}

/// The most likely common factor of the `members` beside the `weights`; `None` where the likelihood has no
/// maximum in the range searched.
///
/// Its interval covers both chance and a misfit of the vehicle: estimates with whitened and with unwhitened
/// noise weigh frequencies differently, and agree where the vehicle is correct (Hausman 1978).
pub(super) fn factor(columns: &Columns, weights: &[f64], members: &[usize]) -> Option<Factor> {
    let white = FactorLikelihood::new(columns, weights, true).factor(weights, members)?;
    let raw = FactorLikelihood::new(columns, weights, false).factor(weights, members)?;
    Some(Factor { log: white.log, half: FACTOR_SIGMAS * white.half + (white.log - raw.log).abs() })
}

/// The weights, those of all inputs other than the `members` at their own most likely values: one of them may have a fault,
/// and its responses are correlated with those to the others. The sources of a channel are all outputs, then all inputs.
pub(super) fn other_inputs_free(columns: &Columns, weights: &[f64], members: &[usize]) -> Vec<f64> {
    let mut weights = weights.to_vec();
    for input in (columns.channels.len()..weights.len()).filter(|input| !members.contains(input)) {
        if let Some(factor) = factor(columns, &weights, &[input]) {
            weights[input] *= factor.log.exp();
        }
    }
    weights
}

impl FactorLikelihood {
    /// Likelihood under the noise model of the weighted columns, whitened or as it is.
    fn new(columns: &Columns, weights: &[f64], white: bool) -> Self {
        let one = |columns: &Vec<Vec<f64>>| {
            let rows = columns.first().map_or(0, Vec::len) as f64;
            if !white {
                return Products { products: products(columns), rows };
            }
            let (_, ar) = Columns::residual(columns, weights);
            let filtered: Vec<Vec<f64>> = columns.iter().map(|c| filtered(&ar, c)).collect();
            Products { products: products(&filtered), rows }
        };
        Self { channels: columns.channels.iter().map(one).collect() }
    }

    /// Logarithm of the likelihood, without constants.
    fn at(&self, weights: &[f64]) -> f64 {
        let one = |(i, c): (usize, &Products)| {
            let variance = (energy(&c.products, weights) / c.rows.max(1.0)).max(f64::MIN_POSITIVE);
            c.rows * (weights[i].abs().ln() - 0.5 * variance.ln())
        };
        self.channels.iter().enumerate().map(one).sum()
    }

    /// The most likely factor, with its standard error as the half width of its interval.
    fn factor(&self, weights: &[f64], members: &[usize]) -> Option<Factor> {
        let at = |log: f64| self.at(&scaled(weights, members, log.exp()));
        let reach = GREATEST_FACTOR.ln();
        let step = 0.1;
        let steps = (2.0 * reach / step) as usize;
        let grid = (0..=steps).map(|i| i as f64 * step - reach);
        let start = grid.map(|x| (x, at(x))).max_by(|a, b| a.1.total_cmp(&b.1))?.0;
        if start.abs() > reach - 2.0 * step {
            return None;
        }
        let log = highest(at, start - step, start + step);
        let h = 1e-3;
        let curvature = -(at(log + h) - 2.0 * at(log) + at(log - h)) / (h * h);
        (curvature > 0.0).then(|| Factor { log, half: 1.0 / curvature.sqrt() })
    }
}

/// Weights with those of the `members` multiplied by a factor.
pub(super) fn scaled(weights: &[f64], members: &[usize], factor: f64) -> Vec<f64> {
    let mut weights = weights.to_vec();
    members.iter().for_each(|s| weights[*s] *= factor);
    weights
}

fn about_mean(column: &[f64]) -> Vec<f64> {
    let middle = mean(column);
    column.iter().map(|v| v - middle).collect()
}

/// Inner products of all columns over the rows that have a past in a noise model.
fn products(columns: &[Vec<f64>]) -> DMatrix<f64> {
    let n = columns.len();
    let late = |c: &[f64]| c.get(SCREENED_AR_ORDER..).unwrap_or_default().to_vec();
    let columns: Vec<Vec<f64>> = columns.iter().map(|c| late(c)).collect();
    let mut products = DMatrix::zeros(n, n);
    for a in 0..n {
        for b in 0..=a {
            let v = dot(&columns[a], &columns[b]);
            (products[(a, b)], products[(b, a)]) = (v, v);
        }
    }
    products
}

/// Sum of squares of the weighted columns, at least the rounding error.
fn energy(products: &DMatrix<f64>, weights: &[f64]) -> f64 {
    let (mut sum, mut size) = (0.0, 0.0f64);
    for (a, wa) in weights.iter().enumerate() {
        size = size.max(wa * wa * products[(a, a)]);
        for (b, wb) in weights.iter().enumerate() {
            sum += wa * wb * products[(a, b)];
        }
    }
    sum.max(ROUNDING * size)
}

/// Maximum of a unimodal function between two points, by golden section (Kiefer 1953).
fn highest(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let share = 0.5 * (5f64.sqrt() - 1.0);
    for _ in 0..40 {
        let (a, b) = (high - share * (high - low), low + share * (high - low));
        if f(a) > f(b) {
            high = b;
        } else {
            low = a;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    /// An actuator that has lost two thirds of its effect made the unit of another command look wrong, as the two move together.
    #[test]
    fn the_size_of_an_input_does_not_depend_on_a_fault_of_another() {
        let mut stream = Stream::new(7, "commands");
        let (mut output, mut weak, mut right) = (Vec::new(), Vec::new(), Vec::new());
        let mut slow = 0.0;
        for _ in 0..2000 {
            slow = 0.9 * slow + stream.normal();
            let own = 0.5 * slow + 0.2 * stream.normal();
            output.push(0.3 * slow + own + 0.1 * stream.normal());
            // The innovation is the output less the responses to the inputs.
            weak.push(-slow);
            right.push(-own);
        }
        let columns = Columns { channels: vec![vec![output, weak, right]], declared: vec![0.1] };
        let ones = [1.0; 3];
        let alone = factor(&columns, &ones, &[2]);
        assert!(alone.is_none_or(|factor| factor.log.abs() > 3.0 * factor.half), "{alone:?}");
        let weights = other_inputs_free(&columns, &ones, &[2]);
        let beside = factor(&columns, &weights, &[2]).unwrap();
        assert!(beside.log.abs() < 0.5, "{weights:?}: {beside:?}");
    }
}
