//! Resampling to a slower clock, without aliasing of frequencies above the new Nyquist frequency.
//!
//! A windowed sinc suppresses aliasing fully and colours white noise slightly. The mean over each period leaves
//! white noise white and lets a part of the fast content alias. The first is for signals without gaps that are
//! plotted; the second is for records with missing samples whose noise is evaluated.

use std::borrow::Cow;
use std::f64::consts::PI;

use super::clock::{Clock, TOLERANCE};
use super::linear::interpolate;
use crate::sampling::{median_interval, repeated_every};

/// Edges of the low-pass as shares of the new rate: flat up to the first, 60 dB down from the second on.
const PASS: f64 = 0.4;
const STOP: f64 = 0.5;
const ATTENUATION_DB: f64 = 60.0;

/// Filters a part of a signal on a grid that divides the clock's period, and then takes the points of the
/// clock.
pub(super) fn decimate(time: &[f64], values: &[f64], median: f64, clock: &Clock, out: &mut [f64]) {
    let ratio = (clock.period / median - TOLERANCE).ceil().max(2.0) as usize;
    let fine = clock.period / ratio as f64;
    let points = clock.within(time[0], time[time.len() - 1]);
    if points.is_empty() {
        return;
    }
    // The fine grid reaches to both ends of the part; point k of the clock is grid point `lead + (k - first) ratio`.
    let origin = clock.at(points.start);
    let lead = ((origin - time[0]) / fine + TOLERANCE).floor().max(0.0) as usize;
    let tail = ((time[time.len() - 1] - origin) / fine + TOLERANCE).floor().max(0.0) as usize;
    let grid: Vec<f64> = (0..=lead + tail)
        .map(|g| interpolate(time, values, origin + (g as f64 - lead as f64) * fine))
        .collect();
    let kernel = low_pass(ratio);
    let half = kernel.len() as isize / 2;
    for (n, k) in points.enumerate() {
        let centre = (lead + n * ratio) as isize;
        out[k] = kernel.iter().zip(-half..).map(|(h, d)| h * reflected(&grid, centre + d)).sum();
    }
}

/// A grid value; beyond an end, mirrored through the end point, so that a slope continues.
fn reflected(grid: &[f64], index: isize) -> f64 {
    let last = grid.len() as isize - 1;
    if index < 0 {
        2.0 * grid[0] - grid[(-index).min(last) as usize]
    } else if index > last {
        2.0 * grid[last as usize] - grid[(2 * last - index).max(0) as usize]
    } else {
        grid[index as usize]
    }
}

/// Filter taps of the low-pass for decimation by `ratio`; their sum is 1.
fn low_pass(ratio: usize) -> Vec<f64> {
    let ratio = ratio as f64;
    // Kaiser's formulas for length and shape.
    let transition = 2.0 * PI * (STOP - PASS) / ratio;
    let half = ((ATTENUATION_DB - 7.95) / (2.285 * transition) / 2.0).ceil();
    let beta = 0.1102 * (ATTENUATION_DB - 8.7);
    let cutoff = 0.5 * (PASS + STOP) / ratio;
    let taps: Vec<f64> = (-(half as isize)..=half as isize)
        .map(|n| {
            let n = n as f64;
            let x = 2.0 * PI * cutoff * n;
            let sinc = if n == 0.0 { 1.0 } else { x.sin() / x };
            sinc * bessel_i0(beta * (1.0 - (n / half).powi(2)).max(0.0).sqrt())
        })
        .collect();
    let sum: f64 = taps.iter().sum();
    taps.iter().map(|h| h / sum).collect()
}

/// Modified Bessel function of the first kind and order 0, by its power series.
fn bessel_i0(x: f64) -> f64 {
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..60 {
        term *= (x / 2.0 / f64::from(k)).powi(2);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}

/// Mean over one period around each point of a slower clock. Every sample represents one sampling interval around
/// it and is weighted with the part of that interval inside the period, so that the mean has no time shift where
/// samples are on the edge. Samples that are NaN are ignored, as are those that only repeat the last value of a
/// slower sensor, which would delay the mean. NaN where no sample counts.
pub fn averaged(time: &[f64], values: &[f64], clock: &Clock) -> Vec<f64> {
    let values = &fresh(time, values)[..];
    let own = median_interval(time).unwrap_or(clock.period);
    let reach = 0.5 * (clock.period + own);
    (0..clock.points)
        .map(|k| {
            let t = clock.at(k);
            let from = time.partition_point(|v| *v <= t - reach);
            let until = time.partition_point(|v| *v < t + reach);
            let (mut sum, mut weights) = (0.0, 0.0);
            for (at, value) in time[from..until].iter().zip(&values[from..until]) {
                let weight = (reach - (at - t).abs()).min(own);
                if value.is_finite() && weight > TOLERANCE * own {
                    sum += weight * value;
                    weights += weight;
                }
            }
            if weights > 0.0 { sum / weights } else { f64::NAN }
        })
        .collect()
}

/// The values of a slower sensor with repetitions of its last value replaced by NaN: values that change are kept,
/// and those at whole multiples of its own period after a change. Where samples are missing, the times at which it measured
/// go on.
fn fresh<'v>(time: &[f64], values: &'v [f64]) -> Cow<'v, [f64]> {
    let usual = median_interval(time).unwrap_or(1.0);
    // Counted from sample to sample: a clock that jitters, or whose median step is not its mean one, counts each once.
    let mut last = 0;
    let mut after = |pair: &[f64]| {
        last += (((pair[1] - pair[0]) / usual).round() as usize).max(1);
        last
    };
    let steps: Vec<usize> = std::iter::once(0).chain(time.windows(2).map(&mut after)).collect();
    let Some((first, every)) = repeated_every(&steps, values) else { return Cow::Borrowed(values) };
    let mut changed = first % every;
    let value = |k: usize| {
        if k > 0 && values[k] != values[k - 1] && steps[k] == steps[k - 1] + 1 {
            changed = steps[k];
        }
        if steps[k].abs_diff(changed).is_multiple_of(every) { values[k] } else { f64::NAN }
    };
    Cow::Owned((0..values.len()).map(value).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_average_is_neither_early_nor_late() {
        let time: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).collect();
        let line: Vec<f64> = time.iter().map(|t| 3.0 * t).collect();
        for period in [0.02, 0.03, 0.04, 0.05] {
            let clock = Clock { start: 0.4, period, points: 100 };
            for (k, mean) in averaged(&time, &line, &clock).iter().enumerate() {
                assert!((mean - 3.0 * clock.at(k)).abs() < 1e-9, "{period} {k}: {mean}");
            }
        }
    }

    /// Like a satellite receiver, each value of which is repeated in the record until the next.
    #[test]
    fn repeats_of_a_slow_sensor_do_not_make_it_late() {
        let time: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.001).collect();
        let held: Vec<f64> = (0..1000).map(|i| 3.0 * 0.001 * f64::from(i / 10 * 10)).collect();
        let clock = Clock { start: 0.1, period: 0.01, points: 80 };
        for (k, mean) in averaged(&time, &held, &clock).iter().enumerate() {
            assert!((mean - 3.0 * clock.at(k)).abs() < 1e-9, "{k}: {mean}");
        }
    }
}
