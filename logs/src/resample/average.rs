//! Resampling to a slower clock by averages over its periods.
//!
//! A windowed sinc suppresses aliasing fully and colours white noise slightly. An average over each period leaves white
//! noise white and lets a part of the fast content alias. The first is for signals without gaps that are plotted; the
//! second is for records with missing samples whose noise is evaluated.

use std::borrow::Cow;

use super::clock::{Clock, TOLERANCE};
use crate::sampling::{median_interval, repeated_every};

/// Average over one period around each point of a slower clock: the value there of a line fitted to the samples in the
/// period. Every sample represents one sampling interval around it and is weighted with the part of that interval inside
/// the period. Where the samples lie evenly about the point, this is their mean; beside a missing sample, at the ends,
/// and where the period is no multiple of the sampling interval the mean would be that of an earlier or later moment.
/// Where the line knows the value worse than a single sample would, as at the edge of a gap, it is missing.
///
/// Samples that are NaN are ignored, as are those that only repeat the last value of a slower sensor, which would
/// delay the average. NaN where no sample counts.
pub fn averaged(time: &[f64], values: &[f64], clock: &Clock) -> Vec<f64> {
    let values = &fresh(values)[..];
    let own = median_interval(time).unwrap_or(clock.period);
    let reach = 0.5 * (clock.period + own);
    let cell = |k: usize| {
        let t = clock.at(k);
        let from = time.partition_point(|v| *v <= t - reach);
        let until = time.partition_point(|v| *v < t + reach);
        time[from..until].iter().zip(&values[from..until]).filter_map(move |(at, value)| {
            let weight = (reach - (at - t).abs()).min(own) / own;
            let (t, y) = ((at - t) / own, *value);
            (y.is_finite() && weight > TOLERANCE).then_some(Sample { weight, t, y })
        })
    };
    let counts = (0..clock.points).map(|k| cell(k).count()).filter(|count| *count > 0);
    let (cells, samples) = counts.fold((0, 0), |(cells, samples), count| (cells + 1, samples + count));
    // A sensor as slow as the clock has one sample around a point: no line goes through it.
    if samples < 2 * cells {
        return (0..clock.points).map(|k| mean(cell(k))).collect();
    }
    (0..clock.points).map(|k| line(cell(k))).collect()
}

/// A sample of a period.
#[derive(Debug, Clone, Copy)]
struct Sample {
    weight: f64,
    /// Time from the point of the clock, in sampling intervals.
    t: f64,
    y: f64,
}

/// Weighted mean of samples; NaN without any.
fn mean(samples: impl Iterator<Item = Sample>) -> f64 {
    let (weights, sum) = samples.fold((0.0, 0.0), |(w, y), s| (w + s.weight, y + s.weight * s.y));
    if weights > 0.0 { sum / weights } else { f64::NAN }
}

/// Value at time zero of the weighted line through samples; NaN where its variance would exceed that of a single sample.
fn line(samples: impl Iterator<Item = Sample> + Clone) -> f64 {
    let sum = |f: &dyn Fn(&Sample) -> f64| samples.clone().map(|s| s.weight * f(&s)).sum::<f64>();
    let weights = sum(&|_| 1.0);
    let middle = sum(&|s| s.t) / weights;
    let spread = sum(&|s| (s.t - middle).powi(2));
    // Samples about the point need no slope; a single one beside it has none.
    let slope = if middle == 0.0 { 0.0 } else { middle / spread };
    let share = |s: &Sample| s.weight * (1.0 / weights - slope * (s.t - middle));
    let variance: f64 = samples.clone().map(|s| share(&s).powi(2)).sum();
    let known = weights > 0.0 && variance <= 1.0 + TOLERANCE;
    if known { samples.map(|s| share(&s) * s.y).sum() } else { f64::NAN }
}

/// The values of a slower sensor with repetitions of its last value replaced by NaN: values that change are kept,
/// and those at whole multiples of its own period after a change.
fn fresh(values: &[f64]) -> Cow<'_, [f64]> {
    let Some((first, every)) = repeated_every(values) else { return Cow::Borrowed(values) };
    let mut changed = first % every;
    let value = |k: usize| {
        if k > 0 && values[k] != values[k - 1] {
            changed = k;
        }
        if k.abs_diff(changed).is_multiple_of(every) { values[k] } else { f64::NAN }
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

    #[test]
    fn an_average_beside_a_missing_sample_is_neither_early_nor_late() {
        let mut time: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.01).collect();
        let mut line: Vec<f64> = time.iter().map(|t| 3.0 * t).collect();
        line[300] = f64::NAN;
        line[600..620].fill(f64::NAN);
        time.drain(400..402);
        line.drain(400..402);
        for period in [0.04, 0.0414, 0.05] {
            let clock = Clock::over(0.0, 9.99, period).unwrap();
            let means = averaged(&time, &line, &clock);
            let missing = means.iter().filter(|mean| mean.is_nan()).count();
            assert!((2..=7).contains(&missing), "{period}: {missing}");
            for (k, mean) in means.iter().enumerate().filter(|(_, mean)| mean.is_finite()) {
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
