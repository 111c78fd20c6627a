//! Likelihood of a residual as turbulence on one state beside noise of the channels: Kalman's innovations.
//!
//! Exact where Whittle's approximation is not: when the motion stands far above the noise, what leaks between
//! frequencies would drown the noise.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use whirlstand_vehicle::{Vehicle, discretise};

use super::data::Data;
use super::noise::MOST;

/// Steps after which a filter's covariance is taken as settled.
const SETTLED: usize = 400;

/// Parameters of the noises: logarithms of the turbulence's standard deviation and bandwidth, then for every channel the
/// logarithm of its standard deviation and its pole.
#[derive(Debug, Clone, PartialEq)]
pub struct Noises {
    /// ln(std) and ln(bandwidth_hz).
    pub common: [f64; 2],
    /// ln(std) of each channel's own noise.
    pub own: Vec<f64>,
    /// Pole of each channel's own noise, first order; 0 for white.
    pub poles: Vec<f64>,
}

impl Noises {
    /// Index of the first pole among all values.
    fn poles_from(&self) -> usize {
        2 + self.own.len()
    }

    /// A pole of zero stays there.
    fn is_open(&self, value: usize) -> bool {
        value < self.poles_from() || self.poles[value - self.poles_from()] != 0.0
    }

    /// All values moved: logarithms, then the poles' inverse hyperbolic tangents.
    fn moved(&self, step: &[f64]) -> Self {
        let mut next = self.clone();
        next.common.iter_mut().chain(&mut next.own).zip(step).for_each(|(v, d)| *v += d);
        for (pole, d) in next.poles.iter_mut().zip(&step[self.poles_from()..]).filter(|(pole, _)| **pole != 0.0) {
            *pole = (pole.atanh() + d).tanh().clamp(-0.9999, 0.9999);
        }
        next
    }
}

/// The filter of one set of noises: states of the vehicle, the turbulence, and one state for each channel whose noise
/// has a pole.
struct Filter {
    f: DMatrix<f64>,
    q: DMatrix<f64>,
    h: DMatrix<f64>,
    r: DMatrix<f64>,
    /// Index and variance of the turbulence, whose spread at the beginning is its own.
    turbulence: (usize, f64),
}

impl Filter {
    fn new(data: &Data, vehicle: &Vehicle, state: usize, noises: &Noises) -> Option<Self> {
        let (n, p) = (vehicle.states.len(), data.channels.len());
        let coloured: Vec<usize> = (0..p).filter(|c| noises.poles[*c] != 0.0).collect();
        let order = n + 1 + coloured.len();
        let (std, rate) = (noises.common[0].exp(), std::f64::consts::TAU * noises.common[1].exp());
        let mut push = DMatrix::zeros(n, 1);
        push[(state, 0)] = 1.0;
        let (phi, gamma) = discretise(&vehicle.a, &push, data.period_s).ok()?;
        let decay = (-rate * data.period_s).exp();
        let mut f = DMatrix::zeros(order, order);
        f.view_mut((0, 0), (n, n)).copy_from(&phi);
        f.view_mut((0, n), (n, 1)).copy_from(&gamma);
        f[(n, n)] = decay;
        let mut q = DMatrix::zeros(order, order);
        q[(n, n)] = std * std * (1.0 - decay * decay);
        let (mut h, mut r) = (DMatrix::zeros(p, order), DMatrix::zeros(p, p));
        for (c, channel) in data.channels.iter().enumerate() {
            for j in 0..n {
                h[(c, j)] = vehicle.c[(channel.output, j)];
            }
            let variance = (2.0 * noises.own[c]).exp();
            match coloured.iter().position(|i| *i == c) {
                None => r[(c, c)] = variance,
                Some(i) => {
                    let at = n + 1 + i;
                    h[(c, at)] = 1.0;
                    f[(at, at)] = noises.poles[c];
                    q[(at, at)] = variance;
                }
            }
        }
        Some(Self { f, q, h, r, turbulence: (n, std * std) })
    }
}

/// Logarithm of the likelihood of a residual, without constants, over the rows that every noise model is judged by; all
/// channels must have one sample a step. `None` when the filter has no finite gain.
pub fn log_likelihood(
    data: &Data,
    vehicle: &Vehicle,
    state: usize,
    residual: &[f64],
    noises: &Noises,
) -> Option<f64> {
    let filter = Filter::new(data, vehicle, state, noises)?;
    let (f, h) = (&filter.f, &filter.h);
    let p = data.channels.len();
    let mut covariance = filter.q.clone();
    let (turbulence, variance) = filter.turbulence;
    covariance[(turbulence, turbulence)] = variance;
    // The initial state was fitted as if there were no turbulence: it is open again. The rows that no likelihood counts
    // settle it.
    let open = 100.0 * residual.iter().fold(0.0f64, |m, r| m.max(r.abs()));
    (0..turbulence).for_each(|i| covariance[(i, i)] += open * open);
    let ranges = data.ranges();
    let rows = ranges.iter().map(|r| r.len()).min()?;
    let mut x = DVector::zeros(f.nrows());
    let mut next = x.clone();
    let mut e = DVector::zeros(p);
    let (mut sum, mut settled) = (0.0, false);
    // Gain, inverse factor of the innovations' covariance, logarithm of its determinant.
    let mut update = (DMatrix::zeros(f.nrows(), p), DMatrix::zeros(p, p), 0.0);
    for k in 0..rows {
        for (c, range) in ranges.iter().enumerate() {
            e[c] = residual[range.start + k];
        }
        e.gemv(-1.0, h, &x, 1.0);
        if !settled {
            let crossed = &covariance * h.transpose();
            let factor = (h * &crossed + &filter.r).cholesky()?;
            let log_det = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
            let shifted = f * &crossed;
            let gain = factor.solve(&shifted.transpose()).transpose();
            let after = f * &covariance * f.transpose() + &filter.q - &gain * shifted.transpose();
            let change = (&after - &covariance).amax() / after.amax().max(f64::MIN_POSITIVE);
            covariance = (&after + after.transpose()) * 0.5;
            settled = k > SETTLED || change < 1e-6;
            update = (gain, factor.inverse(), log_det);
        }
        let (gain, inverse, log_det) = &update;
        if k >= MOST {
            let mut square = 0.0;
            for j in 0..p {
                for i in 0..p {
                    square += inverse[(i, j)] * e[i] * e[j];
                }
            }
            sum -= 0.5 * (log_det + square);
        }
        next.gemv(1.0, f, &x, 0.0);
        next.gemv(1.0, gain, &e, 1.0);
        std::mem::swap(&mut x, &mut next);
    }
    sum.is_finite().then_some(sum)
}

/// Rounds of a climb, at most.
const ROUNDS: usize = 15;

/// Climbs from `noises` to the greatest likelihood by Newton's steps with the curvatures of the single values, those of
/// the turbulence's two together; what the climb gained last is below a tenth. Returns noises, likelihood and standard
/// errors of the first two values.
pub fn climb(
    data: &Data,
    vehicle: &Vehicle,
    state: usize,
    residual: &[f64],
    mut noises: Noises,
) -> Option<(Noises, f64, [f64; 2])> {
    let value = |noises: &Noises| log_likelihood(data, vehicle, state, residual, noises);
    let mut best = value(&noises)?;
    let count = 2 + noises.own.len() + noises.poles.len();
    let mut reach = vec![0.1; count];
    let mut curvatures = vec![0.0; count];
    for _ in 0..ROUNDS {
        let moved = |i: usize, by: f64| {
            let mut step = vec![0.0; count];
            step[i] = by;
            value(&noises.moved(&step))
        };
        let open: Vec<usize> = (0..count).filter(|i| noises.is_open(*i)).collect();
        let sides: Vec<Option<(f64, f64)>> =
            open.par_iter().map(|i| Some((moved(*i, reach[*i])?, moved(*i, -reach[*i])?))).collect();
        let mut step = vec![0.0; count];
        for (i, side) in open.into_iter().zip(sides) {
            let (up, down) = side?;
            let slope = (up - down) / (2.0 * reach[i]);
            curvatures[i] = (2.0 * best - up - down) / (reach[i] * reach[i]);
            // Where the likelihood is not yet curved as at a top: a bold step uphill.
            step[i] = if curvatures[i] > 0.0 { slope / curvatures[i] } else { slope.signum() };
            step[i] = step[i].clamp(-1.0, 1.0);
        }
        let before = best;
        let mut share = 1.0;
        while share > 0.05 {
            let next = noises.moved(&step.iter().map(|d| share * d).collect::<Vec<_>>());
            if let Some(v) = value(&next)
                && v > best
            {
                (noises, best) = (next, v);
                break;
            }
            share *= 0.5;
        }
        reach.iter_mut().zip(&step).for_each(|(r, d)| *r = (0.5 * d.abs()).clamp(0.02, 0.3));
        if best - before < 0.1 {
            break;
        }
    }
    // Size and bandwidth go together: the cross curvature belongs to their errors.
    let d = [0.05, 0.05];
    let at = |a: f64, b: f64| {
        let mut next = noises.clone();
        next.common[0] += a;
        next.common[1] += b;
        value(&next)
    };
    let cross = -(at(d[0], d[1])? - at(d[0], -d[1])? - at(-d[0], d[1])? + at(-d[0], -d[1])?) / (4.0 * d[0] * d[1]);
    let determinant = curvatures[0] * curvatures[1] - cross * cross;
    let errors = if determinant > 0.0 {
        [(curvatures[1] / determinant).sqrt(), (curvatures[0] / determinant).sqrt()]
    } else {
        [1.0, 1.0]
    };
    Some((noises, best, errors))
}
