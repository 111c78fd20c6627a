//! Maximum exact likelihood of turbulence on one state, by local optimisation from a nearby start.

use rayon::prelude::*;
use whirlstand_vehicle::Vehicle;

use crate::data::record::Data;
use crate::model::innovations::{Noises, log_likelihood};
use crate::thresholds::{CLIMB_OPTIMISM, MAX_CLIMB_ROUNDS};

/// Logarithm of the prior of a bandwidth, log-normal: any bandwidth that the record can show, from one period
/// in the whole record to half the sampling rate, is within two standard deviations.
fn log_prior(data: &Data, noises: &Noises) -> f64 {
    let (lowest, highest) = bandwidths_hz(data);
    let (middle, spread) = (0.5 * (lowest * highest).ln(), 0.25 * (highest / lowest).ln());
    -0.5 * ((noises.common[1] - middle) / spread).powi(2)
}

/// Lowest and highest bandwidth that a record can show, Hz.
pub fn bandwidths_hz(data: &Data) -> (f64, f64) {
    (1.0 / data.duration_s(), 0.5 / data.period_s)
}

/// Maximisation of the likelihood times the prior of the bandwidth, by Newton steps with one curvature per
/// parameter: each evaluation costs a run of the filter.
struct Climb<'a> {
    value: &'a (dyn Fn(&Noises) -> Option<f64> + Sync),
    noises: Noises,
    best: f64,
    /// Step size of the next finite difference, per parameter.
    reach: Vec<f64>,
    /// Curvatures known so far, per parameter; 0 where unknown.
    curvatures: Vec<f64>,
}

impl Climb<'_> {
    /// The next step and its predicted gain.
    fn step(&mut self) -> Option<(Vec<f64>, f64)> {
        let count = self.noises.count();
        let moved = |i: usize, by: f64| {
            let mut step = vec![0.0; count];
            step[i] = by;
            (self.value)(&self.noises.moved(&step))
        };
        let open: Vec<usize> = (0..count).filter(|i| self.noises.is_open(*i)).collect();
        // Where the curvature is known, a one-sided difference gives the slope.
        let slopes: Vec<Option<(f64, f64)>> = open
            .par_iter()
            .map(|i| {
                let (d, known) = (self.reach[*i], self.curvatures[*i]);
                let up = moved(*i, d)?;
                if known > 0.0 {
                    return Some(((up - self.best) / d + 0.5 * known * d, known));
                }
                let down = moved(*i, -d)?;
                Some(((up - down) / (2.0 * d), (2.0 * self.best - up - down) / (d * d)))
            })
            .collect();
        let mut step = vec![0.0; count];
        let mut hoped = 0.0;
        for (i, slope) in open.into_iter().zip(slopes) {
            let (slope, curvature) = slope?;
            self.curvatures[i] = curvature;
            // Where the likelihood is not yet concave: a bold step uphill.
            step[i] = if curvature > 0.0 { slope / curvature } else { slope.signum() };
            step[i] = step[i].clamp(-1.0, 1.0);
            hoped += (slope * step[i]).abs();
        }
        Some((step, hoped))
    }

    /// Applies as much of a step as increases the likelihood; returns the gain.
    fn take(&mut self, step: &[f64]) -> f64 {
        let before = self.best;
        let mut share = 1.0;
        while share > 0.05 {
            let next = self.noises.moved(&step.iter().map(|d| share * d).collect::<Vec<_>>());
            if let Some(v) = (self.value)(&next)
                && v > self.best
            {
                (self.noises, self.best) = (next, v);
                break;
            }
            share *= 0.5;
        }
        self.reach.iter_mut().zip(step).for_each(|(r, d)| *r = (0.5 * d.abs()).clamp(0.02, 0.3));
        self.best - before
    }

    /// Standard errors of size and bandwidth, which are correlated, from their curvatures and cross curvature
    /// at the maximum; then that of the best-determined combination of both.
    fn errors(&self) -> Option<[f64; 3]> {
        let d = 0.05;
        let at = |a: f64, b: f64| {
            let mut next = self.noises.clone();
            next.common[0] += a * d;
            next.common[1] += b * d;
            (self.value)(&next)
        };
        let corners = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0), (-1.0, -1.0)];
        let values: Vec<f64> = corners.par_iter().map(|(a, b)| at(*a, *b)).collect::<Option<_>>()?;
        let first = (2.0 * self.best - values[0] - values[1]) / (d * d);
        let second = (2.0 * self.best - values[2] - values[3]) / (d * d);
        let cross = 0.5 * ((2.0 * self.best - values[4] - values[5]) / (d * d) - first - second);
        let determinant = first * second - cross * cross;
        let [size, bandwidth] = if determinant > 0.0 && first > 0.0 {
            [second, first].map(|v| (v / determinant).sqrt())
        } else {
            [1.0; 2]
        };
        // The largest curvature in any direction of the two parameters.
        let sharpest = 0.5 * (first + second) + (0.25 * (first - second).powi(2) + cross * cross).sqrt();
        Some([size, bandwidth, if sharpest > 0.0 { sharpest.sqrt().recip() } else { 1.0 }])
    }
}

/// Climbs from `noises` to the maximum likelihood, until a step gains less than a tenth. Returns the noises,
/// the log-likelihood plus log-prior of the bandwidth, and the standard errors of the first two values and of
/// their best-determined combination. A climb that will not reach `wanted` ends early, with errors of one.
pub fn climb(
    data: &Data,
    vehicle: &Vehicle,
    state: usize,
    residual: &[f64],
    noises: Noises,
    wanted: f64,
) -> Option<(Noises, f64, [f64; 3])> {
    let value = |noises: &Noises| {
        Some(log_likelihood(data, vehicle, state, residual, noises)? + log_prior(data, noises))
    };
    let (best, count) = (value(&noises)?, noises.count());
    let mut climb =
        Climb { value: &value, noises, best, reach: vec![0.1; count], curvatures: vec![0.0; count] };
    for _ in 0..MAX_CLIMB_ROUNDS {
        let (step, hoped) = climb.step()?;
        if climb.best + CLIMB_OPTIMISM * hoped + CLIMB_OPTIMISM < wanted {
            return Some((climb.noises, climb.best, [1.0; 3]));
        }
        if climb.take(&step) < 0.1 {
            break;
        }
    }
    let errors = climb.errors()?;
    Some((climb.noises, climb.best, errors))
}
