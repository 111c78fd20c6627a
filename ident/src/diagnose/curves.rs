//! Clouds and lines of which evidence is drawn.

use nalgebra::{DMatrix, DVector};

use super::answer::Points;

/// Points of a cloud.
const CLOUD: usize = 1200;
/// Parts of an axis over which means are taken.
const BINS: usize = 28;
/// Lags of a step response.
const LAGS: usize = 40;

/// Every so many points, so that a cloud stays small.
pub fn thinned(x: &[f64], y: &[f64]) -> Points {
    let every = x.len().div_ceil(CLOUD).max(1);
    let keep = |v: &[f64]| v.iter().step_by(every).copied().collect();
    (keep(x), keep(y))
}

/// Means over equal parts of the x axis, of points that `wanted` asks for; parts with few points are left out.
pub fn binned(x: &[f64], y: &[f64], wanted: impl Fn(usize) -> bool) -> Points {
    let (low, high) = ends(x);
    let width = (high - low) / BINS as f64;
    if !(width > 0.0 && width.is_finite()) {
        return Points::default();
    }
    let mut sums = vec![(0usize, 0.0, 0.0); BINS];
    for (k, (x, y)) in x.iter().zip(y).enumerate() {
        if x.is_finite() && y.is_finite() && wanted(k) {
            let sum = &mut sums[(((x - low) / width) as usize).min(BINS - 1)];
            *sum = (sum.0 + 1, sum.1 + x, sum.2 + y);
        }
    }
    let least = (x.len() / 2000).max(4);
    sums.iter().filter(|s| s.0 >= least).map(|(n, x, y)| (x / *n as f64, y / *n as f64)).unzip()
}

/// Least and greatest value.
pub fn ends(values: &[f64]) -> (f64, f64) {
    let finite = values.iter().copied().filter(|v| v.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)))
}

/// One line after the other, with a gap between.
pub fn joined(mut a: Points, b: Points) -> Points {
    a.0.push(f64::NAN);
    a.1.push(f64::NAN);
    a.0.extend(b.0);
    a.1.extend(b.1);
    a
}

/// The share of a step of `u` that has arrived after a time, from 0 to `reach` steps, where `more` is what is to be added
/// to `u`: least squares over the moves of `u` in the past, with a little ridge. `None` when `u` does not move.
pub fn arrived(u: &[f64], more: &[f64], reach: usize, period_s: f64) -> Option<Points> {
    let every = reach.div_ceil(LAGS).max(1);
    let lags = (reach / every).max(4);
    let n = u.len();
    let first = lags * every;
    if n < 4 * first {
        return None;
    }
    let moves: Vec<f64> = (0..n).map(|k| if k >= every { u[k] - u[k - every] } else { 0.0 }).collect();
    // Every step of the record is one equation; a long record has more than are needed.
    let rows = (first..n).step_by((n / 20_000).max(1));
    let mut information: DMatrix<f64> = DMatrix::zeros(lags, lags);
    let mut right: DVector<f64> = DVector::zeros(lags);
    let mut past = vec![0.0; lags];
    for k in rows {
        for (l, p) in past.iter_mut().enumerate() {
            *p = moves[k - l * every];
        }
        for i in 0..lags {
            if past[i] != 0.0 {
                right[i] += past[i] * more[k];
                for j in 0..=i {
                    information[(i, j)] += past[i] * past[j];
                }
            }
        }
    }
    information.fill_upper_triangle_with_lower_triangle();
    let ridge = 1e-3 * information.trace() / lags as f64;
    if !(ridge > 0.0) {
        return None;
    }
    (0..lags).for_each(|i| information[(i, i)] += ridge);
    let shares = information.cholesky()?.solve(&right);
    Some(((0..lags).map(|l| (l * every) as f64 * period_s).collect(), shares.iter().map(|s| 1.0 + s).collect()))
}

/// The gain by which `u + more` follows `u`, in equal parts of the record.
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

/// The `length` steps over which a difference is largest.
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
        let (t, share) = arrived(&u, &late, 20, 0.1).unwrap();
        for (t, share) in t.iter().zip(&share) {
            let expected = if *t < 0.75 { 0.0 } else { 1.0 };
            assert!((share - expected).abs() < 0.1, "{t} {share}");
        }
        assert!(arrived(&vec![1.0; 2000], &late, 20, 0.1).is_none());
    }

    #[test]
    fn means_and_the_loudest_part() {
        let x: Vec<f64> = (0..1000).map(|k| f64::from(k) / 100.0).collect();
        let y: Vec<f64> = x.iter().map(|x| 2.0 * x).collect();
        let (bx, by) = binned(&x, &y, |_| true);
        assert!(bx.len() == BINS && bx.iter().zip(&by).all(|(x, y)| (y - 2.0 * x).abs() < 1e-9));
        let mut pulse = vec![0.0; 100];
        pulse[40..50].fill(1.0);
        assert_eq!(loudest(&pulse, 10), 40..50);
        assert_eq!(loudest(&[1.0, 2.0], 10), 0..2);
    }
}
