//! Regularity of a signal's sampling, and its gaps.

use std::ops::Range;

use serde::Serialize;

use crate::record::{Record, SignalError};
use crate::stats::median;

/// Length, in median intervals, above which an interval has a missing sample: it is then nearer to two
/// intervals than to one.
pub const GAP: f64 = 1.5;

/// Longest pause of a command that is bridged, in median intervals: two samples may be missing and the clock may jitter by
/// half an interval. Two consecutive lost samples are common on a radio or a busy bus; a longer pause hides motion, and
/// the signal is cut there. A measurement that is missing stays missing.
pub const LONGEST_BRIDGED: f64 = 3.5;

/// Relative deviation of an interval from the median above which sampling is uneven.
const UNEVEN: f64 = 0.01;

/// Statistics of the sampling of a time axis.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Sampling {
    /// Number of points.
    pub points: usize,
    /// Median interval, in the unit of the axis; `None` for fewer than two points.
    pub period: Option<f64>,
    /// Shortest interval.
    pub shortest: Option<f64>,
    /// Longest interval.
    pub longest: Option<f64>,
    /// Standard deviation of the intervals that are not gaps, relative to the median.
    pub jitter: Option<f64>,
    /// Whether an interval that is not a gap deviates from the median by more than 1 %.
    pub uneven: bool,
    /// Intervals longer than 1.5 times the median.
    pub gaps: Vec<Gap>,
}

/// A time without samples.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gap {
    /// Index of the last point before the gap.
    pub after: usize,
    /// Time of that point.
    pub from: f64,
    /// Time of the first point after the gap.
    pub to: f64,
    /// Number of samples that fit into the gap at the median interval.
    pub missing: u64,
}

impl Sampling {
    /// Analyses an increasing time axis.
    pub fn of(time: &[f64]) -> Self {
        let Some(median) = median_interval(time) else {
            return Self { points: time.len(), ..Self::default() };
        };
        let intervals: Vec<f64> = time.windows(2).map(|t| t[1] - t[0]).collect();
        let regular: Vec<f64> = intervals.iter().copied().filter(|dt| *dt <= GAP * median).collect();
        let variance =
            regular.iter().map(|dt| (dt - median).powi(2)).sum::<f64>() / regular.len().max(1) as f64;
        let gaps = intervals
            .iter()
            .enumerate()
            .filter(|(_, dt)| **dt > GAP * median)
            .map(|(after, dt)| Gap {
                after,
                from: time[after],
                to: time[after + 1],
                missing: ((dt / median).round() as u64).saturating_sub(1),
            })
            .collect();
        Self {
            points: time.len(),
            period: Some(median),
            shortest: intervals.iter().copied().reduce(f64::min),
            longest: intervals.iter().copied().reduce(f64::max),
            jitter: Some(variance.sqrt() / median),
            uneven: regular.iter().any(|dt| (dt - median).abs() > UNEVEN * median),
            gaps,
        }
    }

    /// Samples per unit of time.
    pub fn rate(&self) -> Option<f64> {
        self.period.map(|period| 1.0 / period)
    }
}

/// Median interval of a time axis, in its unit; `None` for fewer than two points.
pub fn median_interval(time: &[f64]) -> Option<f64> {
    let intervals: Vec<f64> = time.windows(2).map(|t| t[1] - t[0]).collect();
    (!intervals.is_empty()).then(|| median(&intervals))
}

/// The period of a clock whose stamps are even except for rounding; `None` when there are gaps or jitter.
pub fn even_period(time: &[f64]) -> Option<f64> {
    let (first, last) = (time.first()?, time.last()?);
    let mean = (last - first) / (time.len().checked_sub(1).filter(|n| *n > 0)? as f64);
    // A clock period has about six digits: 0.0016384 s, not 0.00163840001.
    let digits = 10f64.powi(7 - mean.log10().ceil() as i32);
    let rounded = (mean * digits).round() / digits;
    let tolerance = 0.25 * mean;
    let even =
        |period: f64| time.iter().enumerate().all(|(k, t)| (t - first - k as f64 * period).abs() < tolerance);
    [rounded, mean].into_iter().find(|p| even(*p))
}

impl Record {
    /// The period of the record's clock, in the unit of its time axis: that of an even clock, else the median interval;
    /// `None` for fewer than two points.
    pub fn period(&self) -> Option<f64> {
        even_period(&self.time).or_else(|| median_interval(&self.time))
    }
}

/// Pauses of an otherwise regular signal that are longer than [`LONGEST_BRIDGED`]: from the last time before to
/// the first time after each. A signal of which fewer than nine in ten intervals are regular consists of events
/// and has no pauses.
pub fn pauses(time: &[f64]) -> Vec<(f64, f64)> {
    let median = median_interval(time).unwrap_or(0.0);
    gaps(time).into_iter().filter(|(from, to)| to - from > LONGEST_BRIDGED * median).collect()
}

/// Times in which a regular signal, as of [`pauses`], misses one sample or more.
pub fn gaps(time: &[f64]) -> Vec<(f64, f64)> {
    let Some(median) = median_interval(time) else { return Vec::new() };
    let intervals = || time.windows(2).map(|t| t[1] - t[0]);
    if 10 * intervals().filter(|dt| *dt <= GAP * median).count() < 9 * intervals().count() {
        return Vec::new();
    }
    time.windows(2).filter(|t| t[1] - t[0] > GAP * median).map(|t| (t[0], t[1])).collect()
}

/// The parts of a record in which all of `signals` have values and time has no gap, as ranges of its points.
///
/// # Errors
/// [`SignalError`] when the record does not have one of them.
pub fn unbroken(record: &Record, signals: &[&str]) -> Result<Vec<Range<usize>>, SignalError> {
    let columns = signals.iter().map(|name| record.signal(name)).collect::<Result<Vec<_>, _>>()?;
    let gaps: Vec<usize> = Sampling::of(&record.time).gaps.iter().map(|g| g.after).collect();
    let mut parts = Vec::new();
    let mut start = None;
    for i in 0..record.len() {
        if columns.iter().any(|s| s.values[i].is_nan()) {
            parts.extend(start.take().map(|s| s..i));
            continue;
        }
        let begin = *start.get_or_insert(i);
        if gaps.binary_search(&i).is_ok() {
            parts.push(begin..i + 1);
            start = None;
        }
    }
    parts.extend(start.map(|s| s..record.len()));
    Ok(parts)
}

/// Number of changes of a sensor's value from which its own rate can be determined.
const LEAST_CHANGES: usize = 8;

/// For a sensor slower than its record, whose last value is repeated until the next: the step of the first change, and
/// the number of steps between fresh values. `None` for any other sensor. NaN is no value. `steps` are those of the
/// values, one each and increasing. A value that changed while samples are missing became fresh at an unknown step.
pub fn repeated_every(steps: &[usize], values: &[f64]) -> Option<(usize, usize)> {
    let present: Vec<(usize, f64)> =
        steps.iter().copied().zip(values.iter().copied()).filter(|(_, v)| v.is_finite()).collect();
    let usual = middle(present.windows(2).map(|w| w[1].0 - w[0].0))?;
    let changed = present.windows(2).filter(|w| w[1].1 != w[0].1 && w[1].0 - w[0].0 <= usual);
    let changes: Vec<usize> = changed.map(|w| w[1].0).collect();
    if changes.len() < LEAST_CHANGES || changes.len() * 2 > present.len() {
        return None;
    }
    let apart = || changes.windows(2).map(|w| w[1] - w[0]);
    let every = middle(apart())?;
    let regular = apart().filter(|gap| gap.is_multiple_of(every)).count();
    (every > 1 && regular * 10 > changes.len() * 9 - 9).then_some((changes[0], every))
}

/// The upper median.
fn middle(values: impl Iterator<Item = usize>) -> Option<usize> {
    let mut values: Vec<usize> = values.collect();
    values.sort_unstable();
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_even_axis_has_a_rate_and_no_gap() {
        let s = Sampling::of(&(0..100).map(|k| f64::from(k) * 0.01).collect::<Vec<_>>());
        assert!((s.rate().unwrap() - 100.0).abs() < 1e-6);
        assert!(!s.uneven && s.gaps.is_empty());
        assert!(s.jitter.unwrap() < 1e-9);
    }

    #[test]
    fn gaps_and_uneven_sampling_are_found() {
        let mut time: Vec<f64> = (0..50).map(|k| f64::from(k) * 0.01).collect();
        time.extend((54..100).map(|k| f64::from(k) * 0.01));
        time[20] += 0.002;
        let s = Sampling::of(&time);
        assert!(s.uneven);
        assert_eq!(s.gaps.len(), 1);
        assert_eq!((s.gaps[0].after, s.gaps[0].missing), (49, 4));
        assert!((s.longest.unwrap() - 0.05).abs() < 1e-12);
    }

    #[test]
    fn a_regular_signal_pauses_and_events_do_not() {
        let mut time: Vec<f64> = (0..100).map(|k| f64::from(k) * 0.01).collect();
        time.extend((0..100).map(|k| 3.0 + f64::from(k) * 0.01));
        assert_eq!(pauses(&time), [(0.99, 3.0)]);
        let events: Vec<f64> = (0..40).map(|k| f64::from(k * k) * 0.1).collect();
        assert!(pauses(&events).is_empty() && pauses(&[1.0]).is_empty());
    }

    #[test]
    fn a_clock_that_was_rounded_is_even_and_one_with_a_gap_is_not() {
        let rounded: Vec<f64> = (0..2000).map(|k| (f64::from(k) * 0.001_638_4 * 1e4).round() / 1e4).collect();
        assert!((even_period(&rounded).unwrap() - 0.001_638_4).abs() < 1e-7);
        let mut gap = rounded.clone();
        gap[1000..].iter_mut().for_each(|t| *t += 0.1);
        assert_eq!(even_period(&gap), None);
        assert!((Record::new("x", rounded).unwrap().period().unwrap() - 0.001_638_4).abs() < 1e-7);
        assert!((Record::new("x", gap).unwrap().period().unwrap() - 0.001_6).abs() < 1e-9);
    }

    /// A receiver of a tenth of the rate of its record, from which rows are missing: what changed meanwhile is seen late.
    #[test]
    fn a_slow_sensor_is_known_through_gaps() {
        let kept = |k: &usize| k % 98 < 78;
        let value = |k: usize| (k / 10) as f64;
        let steps: Vec<usize> = (0..6000).filter(kept).collect();
        let rows: Vec<f64> = steps.iter().map(|k| value(*k)).collect();
        assert_eq!(repeated_every(&steps, &rows), Some((10, 10)));
        let all: Vec<usize> = (0..6000).collect();
        let grid: Vec<f64> = all.iter().map(|k| if kept(k) { value(*k) } else { f64::NAN }).collect();
        assert_eq!(repeated_every(&all, &grid), Some((10, 10)));
        assert_eq!(repeated_every(&all, &all.iter().map(|k| *k as f64).collect::<Vec<_>>()), None);
    }

    #[test]
    fn too_few_points_say_nothing() {
        for time in [&[][..], &[1.0]] {
            let s = Sampling::of(time);
            assert_eq!((s.period, s.gaps.len()), (None, 0));
        }
    }

    #[test]
    fn unbroken_parts_end_at_gaps_in_time_and_in_values() {
        let mut record = Record::new("x", vec![0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0]).unwrap();
        let nan = f64::NAN;
        record.push("a", "", vec![nan, 1.0, 1.0, 1.0, 1.0, nan, 1.0]).unwrap();
        record.push("b", "", vec![1.0; 7]).unwrap();
        assert_eq!(unbroken(&record, &["a", "b"]).unwrap(), [1..4, 4..5, 6..7]);
        assert_eq!(unbroken(&record, &["b"]).unwrap(), [0..4, 4..7]);
        assert!(unbroken(&record, &["c"]).is_err());
    }
}
