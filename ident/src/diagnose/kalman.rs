//! Likelihood of a residual as turbulence on one state beside noise of the channels: Kalman's innovations.
//!
//! Exact where Whittle's approximation is not: when the motion stands far above the noise, what leaks between
//! frequencies would drown the noise.

use nalgebra::{DMatrix, DVector};
use whirlstand_vehicle::{Vehicle, discretise};

use super::data::Data;
use super::noise::MOST;

/// Steps after which a filter's covariance is taken as settled.
const SETTLED: usize = 2000;

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

/// Logarithm of the likelihood of a residual, without constants, over the rows that every noise model is judged by; all
/// channels must have one sample a step. `None` when the filter has no finite gain.
pub fn log_likelihood(
    data: &Data,
    vehicle: &Vehicle,
    state: usize,
    residual: &[f64],
    noises: &Noises,
) -> Option<f64> {
    let (n, p) = (vehicle.states.len(), data.channels.len());
    let order = n + 1 + p;
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
    let mut h = DMatrix::zeros(p, order);
    for (c, channel) in data.channels.iter().enumerate() {
        for j in 0..n {
            h[(c, j)] = vehicle.c[(channel.output, j)];
        }
        h[(c, n + 1 + c)] = 1.0;
        f[(n + 1 + c, n + 1 + c)] = noises.poles[c];
        q[(n + 1 + c, n + 1 + c)] = (2.0 * noises.own[c]).exp();
    }
    let mut covariance = q.clone();
    covariance[(n, n)] = std * std;
    let ranges = data.ranges();
    let rows = ranges.iter().map(|r| r.len()).min()?;
    let mut x = DVector::zeros(order);
    let mut e = DVector::zeros(p);
    let (mut sum, mut settled) = (0.0, None);
    for k in 0..rows {
        for (c, range) in ranges.iter().enumerate() {
            e[c] = residual[range.start + k];
        }
        e -= &h * &x;
        let (gain, inverse, log_det) = match &settled {
            Some(known) => known,
            None => {
                let innovation = &h * &covariance * h.transpose();
                let factor = innovation.cholesky()?;
                let log_det = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
                let inverse = factor.inverse();
                let gain = &f * &covariance * h.transpose() * &inverse;
                let next = &f * &covariance * f.transpose() + &q - &gain * &h * &covariance * f.transpose();
                let change = (&next - &covariance).amax() / next.amax().max(f64::MIN_POSITIVE);
                covariance = (&next + next.transpose()) * 0.5;
                if k > SETTLED || change < 1e-9 {
                    settled = Some((gain.clone(), inverse.clone(), log_det));
                }
                &(gain, inverse, log_det)
            }
        };
        if k >= MOST {
            sum -= 0.5 * (log_det + e.dot(&(inverse * &e)));
        }
        x = &f * &x + gain * &e;
    }
    sum.is_finite().then_some(sum)
}

/// Climbs from `noises` to the greatest likelihood, one value after the other by parabolas; what the climb gained last is
/// below a tenth. Returns noises, likelihood and standard errors of the first two values.
pub fn climb(
    data: &Data,
    vehicle: &Vehicle,
    state: usize,
    residual: &[f64],
    mut noises: Noises,
) -> Option<(Noises, f64, [f64; 2])> {
    let value = |noises: &Noises| log_likelihood(data, vehicle, state, residual, noises);
    let mut best = value(&noises)?;
    let count = 2 + noises.own.len();
    let mut steps = vec![0.3; count];
    let mut curvatures = vec![0.0; count];
    for _ in 0..12 {
        let before = best;
        for i in 0..count {
            let moved = |by: f64| {
                let mut next = noises.clone();
                if i < 2 { next.common[i] += by } else { next.own[i - 2] += by }
                next
            };
            let (up, down) = (value(&moved(steps[i])), value(&moved(-steps[i])));
            let (Some(up), Some(down)) = (up, down) else { continue };
            let curvature = (2.0 * best - up - down) / (steps[i] * steps[i]);
            curvatures[i] = curvature;
            let slope = (up - down) / (2.0 * steps[i]);
            let by = if curvature > 0.0 {
                (slope / curvature).clamp(-4.0 * steps[i], 4.0 * steps[i])
            } else {
                2.0 * steps[i].copysign(slope)
            };
            let next = moved(by);
            match value(&next) {
                Some(v) if v > best && v >= up.max(down) => (noises, best) = (next, v),
                _ if up > best && up >= down => (noises, best) = (moved(steps[i]), up),
                _ if down > best => (noises, best) = (moved(-steps[i]), down),
                _ => {}
            }
            steps[i] = (0.7 * by.abs()).clamp(0.01, 0.6);
        }
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
