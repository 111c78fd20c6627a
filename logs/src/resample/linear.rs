//! Resampling of sampled signals by linear interpolation.

use super::clock::{Clock, TOLERANCE};
use crate::sampling::{GAP, median_interval};

/// A sampled signal at the points of a clock: the sample where there is one, and linear interpolation between
/// samples. NaN beyond the ends, where a sample is missing ([`GAP`]), and next to a sample that is NaN: what vibrates faster
/// than half the sampling rate over the gap would be made up, and would count as measured.
pub fn interpolated(time: &[f64], values: &[f64], clock: &Clock) -> Vec<f64> {
    let own = median_interval(time).unwrap_or(clock.period);
    let slack = TOLERANCE * own;
    let mut at = 0;
    (0..clock.points)
        .map(|k| {
            let t = clock.at(k);
            while at + 1 < time.len() && time[at + 1] <= t + slack {
                at += 1;
            }
            match (time.get(at), time.get(at + 1)) {
                (Some(on), _) if (on - t).abs() <= slack => values[at],
                (Some(from), Some(to)) if *from < t && to - from <= GAP * own => {
                    values[at] + (values[at + 1] - values[at]) * (t - from) / (to - from)
                }
                _ => f64::NAN,
            }
        })
        .collect()
}

/// Linear between samples, constant beyond the ends. There is at least one sample.
pub(super) fn interpolate(time: &[f64], values: &[f64], t: f64) -> f64 {
    let after = time.partition_point(|s| *s <= t);
    if after == 0 {
        return values[0];
    }
    if after == time.len() {
        return values[after - 1];
    }
    let (t0, t1) = (time[after - 1], time[after]);
    let share = (t - t0) / (t1 - t0);
    values[after - 1] + share * (values[after] - values[after - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_joined_but_not_across_pauses() {
        let time = [0.0, 0.1, 0.2, 0.9, 1.0];
        let y = [0.0, 1.0, 2.0, 9.0, 10.0];
        let at = |t: f64| interpolated(&time, &y, &Clock { start: t, period: 1.0, points: 1 })[0];
        assert!((at(0.05) - 0.5).abs() < 1e-12 && at(0.1) == 1.0 && at(0.5).is_nan());
        assert!((at(0.95) - 9.5).abs() < 1e-9 && at(1.0) == 10.0);
        assert!(at(1.1).is_nan() && at(-0.1).is_nan());
    }

    #[test]
    fn a_missing_sample_is_missing_beside_it_too() {
        let clock = Clock { start: 0.0, period: 0.5, points: 5 };
        let found = interpolated(&[0.0, 1.0, 2.0], &[1.0, f64::NAN, 3.0], &clock);
        assert_eq!((found[0], found[4]), (1.0, 3.0));
        assert!(found[1..4].iter().all(|v| v.is_nan()));
    }
}
