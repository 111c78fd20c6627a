//! An even clock: the times of a resampled signal.

use std::ops::Range;

use crate::record::RecordError;
use crate::sampling::median_interval;
use crate::series::Series;

/// Greatest distance at which a time counts as equal to a sample's, in periods of the clock.
pub(super) const TOLERANCE: f64 = 1e-6;

/// An even clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clock {
    /// Time of the first point, s.
    pub start: f64,
    /// Interval between points, s.
    pub period: f64,
    /// Number of points.
    pub points: usize,
}

/// Why there is no common clock.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ClockError {
    /// The period is not a positive number.
    #[error("a clock needs a positive period")]
    Period,
    /// The signals have no common time, or too little of it to sample.
    #[error("the time spans of the signals do not overlap: {0}")]
    NoOverlap(String),
    /// The clock would have more points than may take memory.
    #[error("{0} points are too many: choose a longer period or a shorter part of the log")]
    TooMany(String),
    /// The clock would have far more points than there are samples.
    #[error(
        "{samples} samples are so far apart that {points} points would lie between them: a timestamp in the log is \
         corrupt, or its pauses are far longer than its recordings; select a part of the log"
    )]
    Sparse {
        /// Points of the clock.
        points: usize,
        /// Samples of all signals.
        samples: usize,
    },
    /// The result is not a record.
    #[error(transparent)]
    Record(#[from] RecordError),
}

/// Most points of a clock: more than any log that fits in memory.
const MOST_POINTS: f64 = 1e9;

/// Number of points that a common clock may always have, and the further number for each sample. Many more points
/// mean one damaged time, which would take the memory of a whole day's log.
const POINTS: usize = 2_000_000;
const POINTS_A_SAMPLE: usize = 100;

impl Clock {
    /// The clock from `start` to `end`.
    ///
    /// # Errors
    /// [`ClockError::Period`] and [`ClockError::TooMany`].
    pub fn over(start: f64, end: f64, period: f64) -> Result<Self, ClockError> {
        if !(period > 0.0 && period.is_finite() && start.is_finite() && end.is_finite()) {
            return Err(ClockError::Period);
        }
        let points = ((end - start) / period + TOLERANCE).floor() + 1.0;
        if points > MOST_POINTS {
            return Err(ClockError::TooMany(format!("{points:.0}")));
        }
        Ok(Self { start, period, points: points.max(0.0) as usize })
    }

    /// The clock of `period` over the time that all series have in common; without a period, that of the fastest
    /// series.
    ///
    /// # Errors
    /// [`ClockError`].
    pub fn common(series: &[Series], period: Option<f64>) -> Result<Self, ClockError> {
        let ends = |s: &Series| Some((*s.time().first()?, *s.time().last()?));
        let spans: Vec<(f64, f64)> = series.iter().filter_map(ends).collect();
        let start = spans.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
        let end = spans.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
        let fastest = series.iter().filter_map(|s| median_interval(s.time())).fold(f64::INFINITY, f64::min);
        if spans.len() < series.len() || spans.is_empty() || start >= end {
            let spans: Vec<String> = series
                .iter()
                .map(|s| match ends(s) {
                    Some((from, to)) => format!("{} from {from} s to {to} s", s.name),
                    None => format!("{} has no sample", s.name),
                })
                .collect();
            return Err(ClockError::NoOverlap(spans.join(", ")));
        }
        let clock = Self::over(start, end, period.unwrap_or(fastest))?;
        let samples: usize = series.iter().map(|s| s.time().len()).sum();
        if period.is_none() && clock.points > POINTS + POINTS_A_SAMPLE * samples {
            return Err(ClockError::Sparse { points: clock.points, samples });
        }
        Ok(clock)
    }

    /// Time of a point.
    pub fn at(&self, point: usize) -> f64 {
        self.start + self.period * point as f64
    }

    /// All points.
    pub fn times(&self) -> Vec<f64> {
        (0..self.points).map(|k| self.at(k)).collect()
    }

    /// The points in a span of time.
    pub(super) fn within(&self, from: f64, to: f64) -> Range<usize> {
        let first = ((from - self.start) / self.period - TOLERANCE).ceil().max(0.0) as usize;
        let end = ((to - self.start) / self.period + TOLERANCE).floor() + 1.0;
        let end = (end.max(0.0) as usize).min(self.points);
        first.min(end)..end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by the fuzz target of ULog: 752 bytes made 13,743,901 points.
    #[test]
    fn one_damaged_time_makes_no_clock_without_end() {
        let series =
            |end: f64| [Series::new("x", "", vec![(0.0, 1.0), (0.01, 2.0), (0.02, 3.0), (end, 4.0)])];
        assert_eq!(Clock::common(&series(0.03), None).unwrap().points, 4);
        assert_eq!(Clock::common(&series(100.0), None).unwrap().points, 10_001, "a pause is none of that");
        let damaged = Clock::common(&series(137_439.0), None).unwrap_err();
        assert!(damaged.to_string().contains("4 samples are so far apart"), "{damaged}");
        assert!(Clock::common(&series(137_439.0), Some(1.0)).is_ok(), "a period that was asked for");
    }
}
