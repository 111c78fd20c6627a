//! Likelihood of a residual as turbulence on one state beside noise of the channels, by the innovations of a
//! Kalman filter.
//!
//! Exact where Whittle's approximation is not: when the motion is far above the noise, leakage between
//! frequencies would mask the noise.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_ident::identify::search::Derivatives;
use whirlstand_vehicle::Vehicle;

use crate::data::record::Data;
use crate::model::columns::Sparse;
use crate::model::innovations::{Filter, Noises, Update};
use crate::thresholds::{MAX_AR_ORDER, MAX_TRANSIENT_STEPS, NOISE_PARAMETER_STEP, SCORED_ROWS};

/// A residual, of which turbulence on one state may be the cause. All channels have one sample per step.
#[derive(Debug, Clone, Copy)]
pub struct Driven<'a> {
    /// The record with the residual's channels.
    pub data: &'a Data,
    /// The vehicle that was simulated.
    pub vehicle: &'a Vehicle,
    /// Index of the state.
    pub state: usize,
    /// Measured minus predicted, with gaps filled.
    pub residual: &'a [f64],
}

impl Driven<'_> {
    /// Log-likelihood, without constants, over the rows that every noise model is judged by. `None` when the filter has
    /// no finite gain.
    pub fn log_likelihood(&self, noises: &Noises) -> Option<f64> {
        let mut run = Run::new(*self, noises)?;
        let mut sum = 0.0;
        run.advance(0..self.rows(), |white, update| {
            sum -= 0.5 * (update.log_det + white.iter().map(|v| v * v).sum::<f64>());
        })?;
        sum.is_finite().then_some(sum)
    }

    /// Fisher information and gradient of the log-likelihood by the fitted parameters of the noises.
    ///
    /// With v the normalised innovations and W the inverse of the lower factor of their covariance, the log-likelihood
    /// is the sum of ln W_cc - v_c^2 / 2. Innovations depend on the past only, so that the information of the
    /// prediction errors (Astrom 1980) becomes the sum of dv dv' + d ln W_cc d ln W_cc'. The derivatives are differences between
    /// filters that run side by side.
    pub fn derivatives(&self, noises: &Noises) -> Option<Derivatives> {
        let moved = noises.open().map(|i| {
            let mut step = vec![0.0; noises.count()];
            step[i] = NOISE_PARAMETER_STEP;
            noises.moved(&step)
        });
        let mut runs = std::iter::once(noises.clone())
            .chain(moved)
            .map(|noises| Run::new(*self, &noises))
            .collect::<Option<Vec<_>>>()?;
        let count = runs.len() - 1;
        let (mut information, mut right) = (DMatrix::zeros(count, count), DVector::zeros(count));
        for from in (0..self.rows()).step_by(SCORED_ROWS) {
            let rows = from..(from + SCORED_ROWS).min(self.rows());
            let chunks = runs.par_iter_mut().map(|run| run.chunk(rows.clone()));
            let mut chunks = chunks.collect::<Option<Vec<_>>>()?.into_iter();
            let Chunk { white, log_diagonal } = chunks.next()?;
            let (mut by_white, mut by_diagonal) = (Vec::new(), Vec::new());
            for chunk in chunks {
                by_white.push(slope(&chunk.white, &white));
                by_diagonal.push(slope(&chunk.log_diagonal, &log_diagonal));
            }
            let (by_white, by_diagonal) = (Sparse::new(by_white), Sparse::new(by_diagonal));
            information += by_white.products() + by_diagonal.products();
            right -= DVector::from_vec(by_white.dots(&white));
            let sums = by_diagonal.columns().iter().map(|by| by.iter().sum::<f64>());
            right.iter_mut().zip(sums).for_each(|(right, sum)| *right += sum);
        }
        Some(Derivatives { information, right })
    }

    fn rows(&self) -> usize {
        self.data.ranges().iter().map(Range::len).min().unwrap_or(0)
    }
}

/// Slope of every value between two runs.
fn slope(moved: &[f64], here: &[f64]) -> Vec<f64> {
    moved.iter().zip(here).map(|(a, b)| (a - b) / NOISE_PARAMETER_STEP).collect()
}

/// Logarithms of the diagonal of the innovations' inverse factor.
fn log_diagonal(update: &Update) -> impl Iterator<Item = f64> + '_ {
    (0..update.inverse_factor.nrows()).map(|c| update.inverse_factor[(c, c)].ln())
}

/// Normalised innovations of some rows, and the logarithms of the diagonals of their inverse factors.
struct Chunk {
    white: Vec<f64>,
    log_diagonal: Vec<f64>,
}

/// A filter on its way through a residual.
struct Run<'a> {
    driven: Driven<'a>,
    filter: Filter,
    ranges: Vec<Range<usize>>,
    covariance: DMatrix<f64>,
    update: Update,
    step: DMatrix<f64>,
    now: DVector<f64>,
    next: DVector<f64>,
    settled: bool,
}

impl<'a> Run<'a> {
    fn new(driven: Driven<'a>, noises: &Noises) -> Option<Self> {
        let filter = Filter::new(driven.data, driven.vehicle, driven.state, noises)?;
        // The initial state was fitted without turbulence: the filter estimates it again. The rows that no
        // likelihood counts let it settle.
        let largest = driven.residual.iter().fold(0.0f64, |m, r| m.max(r.abs()));
        let mut covariance = filter.start(100.0 * largest);
        let update = filter.update(&mut covariance)?;
        let step = filter.step(&update);
        let now = DVector::zeros(step.nrows());
        let (next, ranges) = (now.clone(), driven.data.ranges());
        Some(Self { driven, filter, ranges, covariance, update, step, now, next, settled: false })
    }

    /// Advances over the next rows; `each` receives the normalised innovations of every row that counts.
    fn advance(&mut self, rows: Range<usize>, mut each: impl FnMut(&[f64], &Update)) -> Option<()> {
        let (order, channels) = (self.filter.order(), &self.driven.data.channels);
        for k in rows {
            for (c, range) in self.ranges.iter().enumerate() {
                self.now[order + c] = self.driven.residual[range.start + k];
            }
            self.next.gemv(1.0, &self.step, &self.now, 0.0);
            if k >= MAX_AR_ORDER && channels.iter().all(|c| c.good[k]) {
                each(&self.next.as_slice()[order..], &self.update);
            }
            std::mem::swap(&mut self.now, &mut self.next);
            if k < MAX_TRANSIENT_STEPS && !self.settled {
                let next = self.filter.update(&mut self.covariance)?;
                self.settled = self.update.is_near(&next);
                self.update = next;
                self.step = self.filter.step(&self.update);
            }
        }
        Some(())
    }

    fn chunk(&mut self, rows: Range<usize>) -> Option<Chunk> {
        let mut chunk = Chunk { white: Vec::new(), log_diagonal: Vec::new() };
        self.advance(rows, |white, update| {
            chunk.white.extend_from_slice(white);
            chunk.log_diagonal.extend(log_diagonal(update));
        })?;
        Some(chunk)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::flown::flown;
    use whirlstand_vehicle::{Effect, Kind};

    const STD: f64 = 2.0;
    const BANDWIDTH_HZ: f64 = 0.5;
    const NOISE: f64 = 0.01;

    fn axis() -> Vehicle {
        let text = format!(
            "name = \"axis\"\nA = [[0.0, 1.0], [-4.0, -1.0]]\nB = [[0.0], [3.0]]\nC = [[1.0, 0.0], [0.0, 1.0]]\n\
             states = [{{ name = \"roll\", unit = \"rad\" }}, {{ name = \"roll_rate\", unit = \"rad/s\" }}]\n\
             inputs = [{{ name = \"u_roll\", unit = \"\" }}]\n\
             outputs = [{{ name = \"roll\", unit = \"rad\", noise = {NOISE} }}, \
             {{ name = \"roll_rate\", unit = \"rad/s\", noise = {NOISE} }}]\n"
        );
        Vehicle::parse(&text, "axis.toml").unwrap()
    }

    /// Passes a residual that turbulence on the roll rate has driven, with its true noises.
    fn with_residual<T>(seed: u64, ask: impl Fn(Driven<'_>, &Noises) -> T) -> T {
        let vehicle = axis();
        let mut shaken = vehicle.clone();
        let turbulence = [("std", STD), ("bandwidth_hz", BANDWIDTH_HZ)];
        shaken.add_effect(Effect::new(Kind::Turbulence, "roll_rate", &turbulence).unwrap()).unwrap();
        let data = flown(&shaken, vec![0.0; 600], seed);
        let residual: Vec<f64> = data.channels.iter().flat_map(|c| c.values.clone()).collect();
        let common = [STD.ln(), BANDWIDTH_HZ.ln()];
        let noises = Noises { common, own: vec![NOISE.ln(); 2], partial: vec![[0.0; 2]; 2] };
        ask(Driven { data: &data, vehicle: &vehicle, state: 1, residual: &residual }, &noises)
    }

    #[test]
    fn the_gradient_is_that_of_the_likelihood() {
        with_residual(3, |driven, noises| {
            let coloured = Noises { partial: vec![[0.4, -0.3], [0.6, 0.0]], ..noises.clone() };
            let Derivatives { information, right } = driven.derivatives(&coloured).unwrap();
            for (at, i) in coloured.open().enumerate() {
                let moved = |by: f64| {
                    let mut step = vec![0.0; coloured.count()];
                    step[i] = by;
                    driven.log_likelihood(&coloured.moved(&step)).unwrap()
                };
                let slope = (moved(1e-4) - moved(-1e-4)) / 2e-4;
                let error = (right[at] - slope).abs();
                assert!(
                    error < 0.01 * information[(at, at)].sqrt() + 1e-3 * slope.abs(),
                    "{i}: {} {slope}",
                    right[at]
                );
            }
        });
    }

    /// At the true parameters the score has a mean of zero, and the Fisher information is its covariance.
    #[test]
    fn the_information_is_the_covariance_of_the_score() {
        const SEEDS: u32 = 200;
        let all: Vec<Derivatives> = (0..SEEDS)
            .map(|seed| with_residual(u64::from(seed), |driven, noises| driven.derivatives(noises).unwrap()))
            .collect();
        let count = all[0].right.len();
        for i in 0..count {
            let information = all.iter().map(|d| d.information[(i, i)]).sum::<f64>() / f64::from(SEEDS);
            let mean = all.iter().map(|d| d.right[i]).sum::<f64>() / f64::from(SEEDS);
            let square = all.iter().map(|d| d.right[i] * d.right[i]).sum::<f64>() / f64::from(SEEDS);
            // Four standard errors: of a mean, and of a variance with two hundred values.
            assert!(
                mean.abs() < 4.0 * (information / f64::from(SEEDS)).sqrt(),
                "{i}: mean {mean}, {information}"
            );
            assert!((square / information - 1.0).abs() < 0.4, "{i}: {square} {information}");
        }
    }
}
