//! Maximum exact likelihood of turbulence on one state, from a nearby start.

use std::ops::ControlFlow;

use nalgebra::DMatrix;
use whirlstand_ident::identify::normal::pseudo_inverse;
use whirlstand_ident::identify::search::{Derivatives, Point, search};
use whirlstand_linalg::symmetric_eigen;
use whirlstand_logs::stats::rms;

use crate::data::record::Data;
use crate::model::driven::Driven;
use crate::model::innovations::Noises;
use crate::thresholds::{CLIMB_LIMITS, CLIMB_OPTIMISM, ROUNDING};

/// Mean and standard deviation of the prior of a bandwidth's logarithm: any bandwidth that the record can show, from
/// one period in the whole record to half the sampling rate, is within two standard deviations.
fn prior(data: &Data) -> (f64, f64) {
    let (lowest, highest) = bandwidths_hz(data);
    (0.5 * (lowest * highest).ln(), 0.25 * (highest / lowest).ln())
}

/// Lowest and highest bandwidth that a record can show, Hz.
pub fn bandwidths_hz(data: &Data) -> (f64, f64) {
    (1.0 / data.duration_s(), 0.5 / data.period_s)
}

/// Maximum of the likelihood.
pub struct Maximum {
    /// Turbulence and noise of the channels.
    pub noises: Noises,
    /// Log-likelihood plus logarithm of the prior of the bandwidth.
    pub likelihood: f64,
    /// Standard errors of the logarithms of size and bandwidth, and of their best-determined combination.
    pub errors: [f64; 3],
}

/// Noises on the way to the maximum.
struct Iterate<'a> {
    driven: Driven<'a>,
    noises: Noises,
    /// Distance from the start in each fitted parameter.
    position: Vec<f64>,
    likelihood: f64,
    /// Likelihood below which the maximum is of no interest.
    wanted: f64,
    derivatives: Option<Derivatives>,
}

impl<'a> Iterate<'a> {
    fn new(driven: Driven<'a>, noises: Noises, position: Vec<f64>, wanted: f64) -> Option<Self> {
        let (middle, spread) = prior(driven.data);
        let log_prior = -0.5 * ((noises.common[1] - middle) / spread).powi(2);
        let likelihood = driven.log_likelihood(&noises)? + log_prior;
        Some(Self { driven, noises, position, likelihood, wanted, derivatives: None })
    }

    /// The iterate after a step.
    fn moved(&self, position: &[f64], step: &[f64]) -> Option<Self> {
        let mut all = vec![0.0; self.noises.count()];
        self.noises.open().zip(step).for_each(|(i, step)| all[i] = *step);
        Self::new(self.driven, self.noises.moved(&all), position.to_vec(), self.wanted)
    }

    /// Fisher information and gradient, with those of the prior.
    fn slopes(&self) -> Option<Derivatives> {
        let mut derivatives = self.driven.derivatives(&self.noises)?;
        let (middle, spread) = prior(self.driven.data);
        derivatives.information[(1, 1)] += spread.powi(-2);
        derivatives.right[1] -= (self.noises.common[1] - middle) / (spread * spread);
        Some(derivatives)
    }
}

impl Point for Iterate<'_> {
    fn position(&self) -> &[f64] {
        &self.position
    }

    fn cost(&self) -> f64 {
        -self.likelihood
    }

    /// None also where the maximum seems too far below what is wanted to be worth going on.
    fn derivatives(&mut self) -> Option<Derivatives> {
        let slopes = self.slopes()?;
        let ahead = 0.5 * slopes.right.dot(&(pseudo_inverse(&slopes.information)? * &slopes.right));
        self.derivatives = Some(slopes.clone());
        (self.likelihood + CLIMB_OPTIMISM * (ahead + 1.0) > self.wanted).then_some(slopes)
    }
}

/// Climbs from `noises` to the maximum of the likelihood times the prior of the bandwidth; a climb that will not reach
/// `wanted` ends early.
pub fn climb(driven: Driven<'_>, noises: Noises, wanted: f64) -> Option<Maximum> {
    let position = vec![0.0; noises.parameters()];
    let bounds = bounds(driven, &noises);
    let start = Iterate::new(driven, noises, position, wanted)?;
    let (maximum, _) = search(
        start,
        &bounds,
        CLIMB_LIMITS,
        |iterate: &Iterate<'_>, position, step| iterate.moved(position, step.as_slice()),
        |_, _| ControlFlow::Continue(()),
    );
    let information = match maximum.derivatives {
        Some(ref derivatives) => derivatives.information.clone(),
        None => maximum.slopes()?.information,
    };
    Some(Maximum { errors: errors(&information)?, noises: maximum.noises, likelihood: maximum.likelihood })
}

/// Ranges of the distances from `noises`. Turbulence may explain all of one channel, whose noise then has no most likely
/// size: it ends where it is lost in the rounding of the residual.
fn bounds(Driven { data, residual, .. }: Driven<'_>, noises: &Noises) -> Vec<(f64, f64)> {
    let lowest = |c: usize| 0.5 * ROUNDING.ln() + rms(&residual[data.ranges()[c].clone()]).ln();
    let lower = |i: usize| match noises.own.get(i.wrapping_sub(2)) {
        Some(own) => (lowest(i - 2) - own).min(0.0),
        None => f64::NEG_INFINITY,
    };
    noises.open().map(|i| (lower(i), f64::INFINITY)).collect()
}

/// Standard errors of the logarithms of size and bandwidth beside all other parameters, and of their best-determined
/// combination.
fn errors(information: &DMatrix<f64>) -> Option<[f64; 3]> {
    let covariance = pseudo_inverse(information)?.view((0, 0), (2, 2)).into_owned();
    // The second parameter moves the size as well: see `Noises::moved`.
    let turn = DMatrix::from_row_slice(2, 2, &[1.0, -0.5, 0.0, 1.0]);
    let covariance = &turn * covariance * turn.transpose();
    let least = symmetric_eigen(covariance.clone()).ok()?.0.min();
    Some([covariance[(0, 0)], covariance[(1, 1)], least].map(|variance| variance.max(0.0).sqrt()))
}
