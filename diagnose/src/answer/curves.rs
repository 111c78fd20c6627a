//! Point clouds and lines of the evidence plots.

use crate::thresholds::{AXIS_PARTS, CLOUD_POINTS, STEP_RESPONSE_LAGS, STEP_RESPONSE_MOVES};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::answer::schema::Points;
use crate::model::columns::dot;

/// Keeps every n-th point, so that a cloud stays small.
pub fn thinned(x: &[f64], y: &[f64]) -> Points {
    let every = x.len().div_ceil(CLOUD_POINTS).max(1);
    let keep = |v: &[f64]| v.iter().step_by(every).copied().collect();
    (keep(x), keep(y))
}

/// Means over equal parts of the x axis, of the points for which `wanted` is true. Parts with few points are
/// left out.
pub fn binned(x: &[f64], y: &[f64], wanted: impl Fn(usize) -> bool) -> Points {
    let (low, high) = ends(x);
    let width = (high - low) / AXIS_PARTS as f64;
    if !(width > 0.0 && width.is_finite()) {
        return Points::default();
    }
    let mut sums = vec![(0usize, 0.0, 0.0); AXIS_PARTS];
    for (k, (x, y)) in x.iter().zip(y).enumerate() {
        if x.is_finite() && y.is_finite() && wanted(k) {
            let sum = &mut sums[(((x - low) / width) as usize).min(AXIS_PARTS - 1)];
            *sum = (sum.0 + 1, sum.1 + x, sum.2 + y);
        }
    }
    let least = (x.len() / 2000).max(4);
    sums.iter().filter(|s| s.0 >= least).map(|(n, x, y)| (x / *n as f64, y / *n as f64)).unzip()
}

/// Smallest and largest value.
pub fn ends(values: &[f64]) -> (f64, f64) {
    let finite = values.iter().copied().filter(|v| v.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)))
}

/// Concatenates two lines, separated by a NaN gap.
pub fn joined(mut a: Points, b: Points) -> Points {
    a.0.push(f64::NAN);
    a.1.push(f64::NAN);
    a.0.extend(b.0);
    a.1.extend(b.1);
    a
}

/// Settings of a step response estimate: from changes of the input over `every` steps, at `lags` lags.
pub struct Steps {
    every: usize,
    lags: usize,
    channels: usize,
    /// Model response to the input changes, each channel divided by its noise.
    answers: Vec<f64>,
    noise: Vec<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl Steps {
    /// Number of steps between two lags of a step response that lasts `reach` steps.
    pub fn every(reach: usize) -> usize {
        reach.div_ceil(STEP_RESPONSE_LAGS).max(1)
    }

    /// Changes of an input over `every` steps.
    pub fn moves(u: &[f64], every: usize) -> Vec<f64> {
        (0..u.len()).map(|k| if k >= every { u[k] - u[k - every] } else { 0.0 }).collect()
    }

    /// `answers` are the model's responses to the input changes, channels side by side; `noise` is the
    /// standard deviation of each channel. `None` when the record is short or the changes carry no
    /// information.
    pub fn new(reach: usize, mut answers: Vec<f64>, noise: &[f64]) -> Option<Self> {
        let (every, channels) = (Self::every(reach), noise.len());
        let lags = (reach / every).max(4);
        let n = answers.len() / channels.max(1);
        if n < 4 * lags * every {
            return None;
        }
        for row in answers.chunks_exact_mut(channels) {
            row.iter_mut().zip(noise).for_each(|(y, n)| *y /= n);
        }
        let mut steps = Self {
            every,
            lags,
            channels,
            answers,
            noise: noise.to_vec(),
            factor: Cholesky::new(DMatrix::identity(1, 1))?,
        };
        let mut information: DMatrix<f64> = DMatrix::zeros(lags, lags);
        for i in 0..lags {
            for j in 0..=i {
                information[(i, j)] = steps.rows().map(|k| dot(steps.past(k, i), steps.past(k, j))).sum();
            }
        }
        information.fill_upper_triangle_with_lower_triangle();
        let information_sum = information.trace();
        if information_sum.is_nan() || information_sum <= 0.0 {
            return None;
        }
        // The first share is anything from 0 to 1; each next share is close to the one before.
        let weight = 1.0 / (STEP_RESPONSE_MOVES * STEP_RESPONSE_MOVES);
        information[(0, 0)] += 1.0;
        for i in 1..lags {
            information[(i, i)] += weight;
            information[(i - 1, i - 1)] += weight;
            information[(i, i - 1)] -= weight;
            information[(i - 1, i)] -= weight;
        }
        steps.factor = information.cholesky()?;
        Some(steps)
    }

    /// Steps that each give an equation of the estimate; a long record is subsampled.
    fn rows(&self) -> impl Iterator<Item = usize> + use<> {
        let n = self.answers.len() / self.channels;
        (self.lags * self.every..n).step_by(n.div_ceil(8000).max(1))
    }

    /// The model responses `lag` lags before step `k`.
    fn past(&self, k: usize, lag: usize) -> &[f64] {
        let at = (k - lag * self.every) * self.channels;
        &self.answers[at..at + self.channels]
    }

    /// The share of a step that has arrived as a function of time, estimated from the missing response
    /// `residual` (channels side by side).
    pub fn arrived(&self, residual: &[f64], period_s: f64) -> Points {
        let mut right: DVector<f64> = DVector::zeros(self.lags);
        for k in self.rows() {
            let row = &residual[k * self.channels..(k + 1) * self.channels];
            for lag in 0..self.lags {
                let products =
                    self.past(k, lag).iter().zip(row).zip(&self.noise).map(|((a, r), n)| a * r / n);
                right[lag] += products.sum::<f64>();
            }
        }
        let shares = self.factor.solve(&right);
        let times = (0..self.lags).map(|l| (l * self.every) as f64 * period_s).collect();
        (times, shares.iter().map(|s| 1.0 + s).collect())
    }
}

/// Gain of `u + more` with respect to `u`, in equal parts of the record.
pub fn gains(t: &[f64], u: &[f64], more: &[f64]) -> Points {
    let part = (t.len() / 16).max(1);
    let parts = t.chunks(part).zip(u.chunks(part)).zip(more.chunks(part));
    let gain = |((t, u), more): ((&[f64], &[f64]), &[f64])| {
        let power: f64 = u.iter().map(|u| u * u).sum();
        let along: f64 = u.iter().zip(more).map(|(u, m)| u * m).sum();
        (power > 0.0).then(|| (t[t.len() / 2], 1.0 + along / power))
    };
    parts.filter_map(gain).unzip()
}

/// The window of `length` steps in which a difference has the largest power.
pub fn loudest(difference: &[f64], length: usize) -> std::ops::Range<usize> {
    let length = length.clamp(1, difference.len().max(1)).min(difference.len());
    let mut sum: f64 = difference[..length].iter().map(|d| d * d).sum();
    let mut best = (sum, 0);
    for k in length..difference.len() {
        sum += difference[k].powi(2) - difference[k - length].powi(2);
        if sum > best.0 {
            best = (sum, k + 1 - length);
        }
    }
    best.1..best.1 + length
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_step_arrives_late() {
        let u: Vec<f64> = (0..2000).map(|k| f64::from((k * k / 97) % 5 - 2)).collect();
        let late: Vec<f64> = (0..2000).map(|k| if k < 8 { 0.0 } else { u[k - 8] } - u[k]).collect();
        // A model whose output is the input itself.
        let steps = Steps::new(20, Steps::moves(&u, Steps::every(20)), &[0.05]).unwrap();
        let (t, share) = steps.arrived(&late, 0.1);
        for (t, share) in t.iter().zip(&share) {
            let expected = if *t < 0.75 { 0.0 } else { 1.0 };
            assert!((share - expected).abs() < 0.1, "{t} {share}");
        }
        assert!(Steps::new(20, vec![0.0; 2000], &[0.05]).is_none());
    }

    #[test]
    fn means_and_the_loudest_part() {
        let x: Vec<f64> = (0..1000).map(|k| f64::from(k) / 100.0).collect();
        let y: Vec<f64> = x.iter().map(|x| 2.0 * x).collect();
        let (bx, by) = binned(&x, &y, |_| true);
        assert!(bx.len() == AXIS_PARTS && bx.iter().zip(&by).all(|(x, y)| (y - 2.0 * x).abs() < 1e-9));
        let mut pulse = vec![0.0; 100];
        pulse[40..50].fill(1.0);
        assert_eq!(loudest(&pulse, 10), 40..50);
        assert_eq!(loudest(&[1.0, 2.0], 10), 0..2);
    }
}
