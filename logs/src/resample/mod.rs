//! Signals with clocks of their own, brought onto one even clock.
//!
//! - Onto a faster clock: linear interpolation between samples.
//! - Onto a slower clock: first a low-pass that keeps what lies above the new Nyquist frequency from folding back.
//!   It is a windowed sinc (Kaiser, 60 dB, flat to 0.4 of the new rate), of zero phase (Oppenheim, Schafer,
//!   Discrete-Time Signal Processing, 3rd ed., sections 4.6.1 and 7.5.3).
//! - Control signals are held from sample to sample; each new value is the mean over its interval, which moves the
//!   vehicle as far.
//!
//! Where a sample is missing ([`crate::sampling::GAP`]), there is NaN, not an invention. A control signal is held through
//! pauses of up to [`crate::sampling::LONGEST_BRIDGED`], as is any signal before a low-pass; one that is only sent when it
//! changes is held, however long.
//!
//! [`onto`] does all this for a signal with a clock of its own, and [`resample`] for many. [`held`], [`interpolated`] and
//! [`averaged`] are for the columns of a record, where a NaN says that a sensor gave no fresh value.

mod clock;
mod hold;
mod linear;
mod low_pass;

pub use clock::{Clock, ClockError};
pub use hold::held;
pub use linear::interpolated;
pub use low_pass::averaged;

use std::ops::Range;

use crate::record::Record;
use crate::sampling::{GAP, LONGEST_BRIDGED, median_interval, pauses};
use crate::series::Series;
use clock::TOLERANCE;
use linear::interpolate;
use low_pass::decimate;

/// Ratio of periods below which a clock does not count as slower than a signal.
const SAME_RATE: f64 = 1.05;

/// Resamples series to one clock. Signals for which `held` returns true are held, not interpolated.
///
/// # Errors
/// [`ClockError::Record`] when two series have one name.
pub fn resample(
    origin: &str,
    series: &[Series],
    clock: &Clock,
    held: impl Fn(&str) -> bool,
) -> Result<Record, ClockError> {
    let mut record = Record::new(origin, clock.times())?;
    for s in series {
        record.push(&s.name, &s.unit, onto(s, clock, held(&s.name)))?;
    }
    Ok(record)
}

impl Record {
    /// True when steps of `period` s are so much longer than the record's own, in s, that the record has to be
    /// resampled to them; a step of nearly the same length is the record's own with a rounded number.
    pub fn is_finer_than(&self, period: f64) -> bool {
        self.time_unit == "s" && self.period().is_some_and(|own| period > 1.2 * own)
    }

    /// The record on an even clock of `period` s. Signals for which `held` returns true are held, not
    /// interpolated.
    ///
    /// # Errors
    /// [`ClockError`].
    pub fn resampled(&self, period: f64, held: impl Fn(&str) -> bool) -> Result<Self, ClockError> {
        let (start, end) = match (self.time.first(), self.time.last()) {
            (Some(start), Some(end)) => (*start, *end),
            _ => return Err(ClockError::NoOverlap(format!("{} has no sample", self.origin))),
        };
        let mut record = resample(&self.origin, &self.to_series(), &Clock::over(start, end, period)?, held)?;
        record.time_unit.clone_from(&self.time_unit);
        Ok(record)
    }
}

impl Record {
    /// The record with the mean over each step in place of the sample at its start, for signals that go straight from one
    /// sample to the next. Held over the step it moves a linear system as far as the straight line does, up to a twelfth of
    /// the change times the ratio of the step to the system's time constant.
    pub fn with_means_over_steps(mut self, is_straight: impl Fn(&str) -> bool) -> Self {
        for at in 0..self.signals().len() {
            if is_straight(&self.signals()[at].name) {
                let means = means_over_steps(&self.signals()[at].values);
                self.replace(at, means);
            }
        }
        self
    }

    /// The record with the delays of some signals removed: the new value of `name` at t is its old value at t plus
    /// its delay. NaN where that is beyond the record.
    pub fn without_delays(mut self, delays: &[(String, f64)]) -> Self {
        let series = self.to_series();
        for (name, delay) in delays {
            let Some(at) = self.signals().iter().position(|s| s.name == *name) else { continue };
            let (own, values) = (series[at].time(), series[at].values());
            let median = median_interval(own).unwrap_or(0.0);
            let moved: Vec<f64> = self
                .time
                .iter()
                .map(|t| {
                    let t = t + delay;
                    let after = own.partition_point(|s| *s <= t);
                    let near = after > 0 && after < own.len() && own[after] - own[after - 1] <= GAP * median;
                    if near { interpolate(own, values, t) } else { f64::NAN }
                })
                .collect();
            self.replace(at, moved);
        }
        self
    }
}

/// Means of neighbouring samples; a sample whose successor is missing stays.
pub fn means_over_steps(values: &[f64]) -> Vec<f64> {
    let next = values.iter().skip(1).chain(values.last());
    values
        .iter()
        .zip(next)
        .map(|(own, next)| if next.is_finite() { 0.5 * (own + next) } else { *own })
        .collect()
}

/// The values of a series at the points of a clock; NaN where it has none.
pub fn onto(series: &Series, clock: &Clock, holds: bool) -> Vec<f64> {
    let (time, values) = (series.time(), series.values());
    let median = median_interval(time).unwrap_or(clock.period);
    if holds {
        return held_while_sent(time, values, median, clock);
    }
    if clock.period <= SAME_RATE * median {
        return interpolated(time, values, clock);
    }
    let mut out = vec![f64::NAN; clock.points];
    for part in parts(time, LONGEST_BRIDGED * median) {
        decimate(&time[part.clone()], &values[part], median, clock, &mut out);
    }
    out
}

/// A held signal from its first value to one interval after its last, without its pauses.
fn held_while_sent(time: &[f64], values: &[f64], median: f64, clock: &Clock) -> Vec<f64> {
    let mut out = vec![f64::NAN; clock.points];
    let (Some(first), Some(last)) = (time.first(), time.last()) else { return out };
    let sent = clock.within(*first, last + median);
    out[sent.clone()].copy_from_slice(&held(time, values, clock, values[0])[sent]);
    for (from, to) in pauses(time) {
        // The points between the last interval in which a value holds and the next value.
        out[clock.within(from + median, to - TOLERANCE * clock.period)].fill(f64::NAN);
    }
    out
}

/// Splits a time axis where it pauses for longer than `longest`.
fn parts(time: &[f64], longest: f64) -> Vec<Range<usize>> {
    let mut parts = Vec::new();
    let mut start = 0;
    for i in 1..time.len() {
        if time[i] - time[i - 1] > longest {
            parts.push(start..i);
            start = i;
        }
    }
    if start < time.len() {
        parts.push(start..time.len());
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn series(rate: f64, seconds: f64, f: impl Fn(f64) -> f64) -> Series {
        let samples = (0..=(rate * seconds) as usize).map(|k| k as f64 / rate).map(|t| (t, f(t))).collect();
        Series::new("x", "", samples)
    }

    fn worst(values: &[f64], clock: &Clock, f: impl Fn(f64) -> f64) -> f64 {
        values.iter().enumerate().map(|(k, v)| (v - f(clock.at(k))).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn slower_clocks_keep_what_they_can_show_and_suppress_the_rest() {
        let clock = Clock::over(0.0, 10.0, 0.05).unwrap();
        let kept = |t: f64| (2.0 * PI * 3.0 * t).sin();
        let out = onto(&series(1000.0, 10.0, kept), &clock, false);
        let inner = |v: &[f64]| v[20..181].to_vec();
        let shifted = Clock { start: clock.at(20), ..clock };
        assert!(worst(&inner(&out), &shifted, kept) < 2e-3, "{}", worst(&inner(&out), &shifted, kept));
        // 17.3 Hz would alias to 2.7 Hz at 20 samples/s.
        let out = onto(&series(1000.0, 10.0, |t| (2.0 * PI * 17.3 * t).sin()), &clock, false);
        assert!(worst(&inner(&out), &shifted, |_| 0.0) < 2e-3);
    }

    #[test]
    fn only_signals_that_are_straight_become_means_over_steps() {
        let mut record = Record::new("x", (0..4).map(f64::from).collect()).unwrap();
        record.push("held", "", vec![0.0, 1.0, 4.0, 9.0]).unwrap();
        record.push("straight", "", vec![0.0, 1.0, f64::NAN, 9.0]).unwrap();
        let record = record.with_means_over_steps(|name| name == "straight");
        assert_eq!(record.get("held").unwrap().values, [0.0, 1.0, 4.0, 9.0]);
        let straight = &record.get("straight").unwrap().values;
        assert!(straight[..2] == [0.5, 1.0] && straight[2].is_nan() && straight[3] == 9.0, "{straight:?}");
    }

    #[test]
    fn a_ramp_stays_a_ramp_on_any_clock() {
        let ramp = |t: f64| 3.0 * t - 1.0;
        for period in [0.001, 0.0037, 0.01, 0.013, 0.1] {
            let clock = Clock::over(0.0, 5.0, period).unwrap();
            let out = onto(&series(100.0, 5.0, ramp), &clock, false);
            assert!(worst(&out, &clock, ramp) < 1e-9, "period {period}");
        }
    }

    #[test]
    fn a_missing_measurement_is_not_made_up_and_a_command_is_held_through_a_short_pause() {
        let samples = (0..100).filter(|k| *k != 30 && !(20..22).contains(k) && !(50..60).contains(k));
        let s = Series::new("x", "", samples.map(|k| (f64::from(k) * 0.01, 1.0)).collect());
        let clock = Clock::over(0.0, 0.99, 0.01).unwrap();
        let missing = |out: &[f64]| (0..100).filter(|k| out[*k].is_nan()).collect::<Vec<_>>();
        let long: Vec<usize> = (50..60).collect();
        assert_eq!(missing(&onto(&s, &clock, false)), [&[20, 21, 30], &long[..]].concat());
        assert_eq!(missing(&onto(&s, &clock, true)), long);
    }

    #[test]
    fn a_held_signal_that_is_regular_pauses_too() {
        let samples = (0..100).filter(|k| !(50..60).contains(k));
        let s = Series::new("x", "", samples.map(|k| (f64::from(k) * 0.01, 1.0)).collect());
        let out = onto(&s, &Clock::over(0.0, 0.99, 0.01).unwrap(), true);
        assert!(out[50..60].iter().all(|v| v.is_nan()), "{:?}", &out[48..62]);
        assert!(out[..50].iter().chain(&out[60..]).all(|v| *v == 1.0));
        let changes = Series::new("x", "", vec![(0.0, 1.0), (0.01, 2.0), (0.6, 3.0), (0.99, 4.0)]);
        assert!(onto(&changes, &Clock::over(0.0, 0.99, 0.01).unwrap(), true).iter().all(|v| v.is_finite()));
    }

    #[test]
    fn held_signals_keep_their_edges_and_their_area() {
        let step = |t: f64| if t >= 0.503 { 1.0 } else { 0.0 };
        let s = series(1000.0, 1.0, step);
        let same = onto(&s, &Clock::over(0.0, 1.0, 0.001).unwrap(), true);
        assert_eq!((same[502], same[503]), (0.0, 1.0));
        let slow = onto(&s, &Clock::over(0.0, 0.9, 0.1).unwrap(), true);
        assert_eq!((slow[4], slow[6]), (0.0, 1.0));
        assert!((slow[5] - 0.97).abs() < 1e-9);
    }

    #[test]
    fn the_common_clock_covers_what_all_signals_cover() {
        let a = series(100.0, 2.0, |t| t);
        let b = Series::new("b", "", (0..30).map(|k| (0.5 + f64::from(k) * 0.1, 0.0)).collect());
        let clock = Clock::common(&[a.clone(), b.clone()], None).unwrap();
        assert!((clock.start - 0.5).abs() < 1e-12 && (clock.period - 0.01).abs() < 1e-9);
        assert_eq!(clock.points, 151);
        let record = resample("x", &[a, b], &clock, |_| false).unwrap();
        assert!(record.signals().iter().all(|s| s.values.iter().all(|v| v.is_finite())));
        let late = Series::new("late", "", vec![(9.0, 1.0), (9.1, 1.0)]);
        let error = Clock::common(&[series(10.0, 1.0, |t| t), late], None).unwrap_err().to_string();
        assert_eq!(
            error,
            "the time spans of the signals do not overlap: x from 0 s to 1 s, late from 9 s to 9.1 s"
        );
        assert_eq!(Clock::over(0.0, 1.0, 0.0), Err(ClockError::Period));
        assert!(matches!(Clock::over(0.0, 1e12, 1e-3), Err(ClockError::TooMany(_))));
    }

    proptest! {
        #[test]
        fn a_constant_stays_constant(
            steps in prop::collection::vec(0.001f64..0.02, 2..200),
            period in 0.0005f64..0.2,
            value in -1e3f64..1e3,
            held in any::<bool>(),
        ) {
            let times = steps.iter().scan(0.0, |t, dt| { *t += dt; Some((*t, value)) }).collect();
            let s = Series::new("x", "", times);
            let clock = Clock::common(std::slice::from_ref(&s), Some(period)).unwrap();
            for v in onto(&s, &clock, held) {
                prop_assert!(v.is_nan() || (v - value).abs() <= 1e-9 * (1.0 + value.abs()));
            }
        }
    }
}
