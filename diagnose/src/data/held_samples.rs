//! Held samples: values that a link repeats because a sample was lost.

use std::collections::BTreeMap;

use statrs::distribution::{Continuous, ContinuousCDF, Normal};
use whirlstand_logs::rounding::{MIN_LEVELS, SAME_VALUE};
use whirlstand_logs::stats::{median, rms};
use whirlstand_vehicle::Kind;

use crate::data::record::Channel;
use crate::data::sample_effect::{SampleEffect, longest_run, share_interval};
use crate::thresholds::{
    MIN_HELD_SAMPLES, NEIGHBOURS, NEW_VALUE_SHARE, OFTEN_SHARE, RARE_REPEAT, SLOW_REPEATS,
};

/// Held samples: values that occasionally repeat the one before, other than at `rests`.
pub fn held((index, channel): (usize, &mut Channel), rests: &[bool]) -> Option<SampleEffect> {
    let by_chance = repeats_by_chance(&channel.values);
    // Where the signal hardly moves, a rounded value repeats anyway: a repeat is evidence only where the
    // signal moves.
    let n = by_chance.iter().filter(|p| **p < RARE_REPEAT).count() + 1;
    let repeats: Vec<usize> = (1..channel.values.len())
        .filter(|&k| {
            let same = channel.values[k] == channel.values[k - 1] && by_chance[k - 1] < RARE_REPEAT;
            same && channel.good[k] && channel.good[k - 1] && !rests[k]
        })
        .collect();
    let fraction = repeats.len() as f64 / n as f64;
    if fraction > 1.0 - NEW_VALUE_SHARE {
        return None;
    }
    let chance: f64 = by_chance.iter().filter(|p| **p < RARE_REPEAT).sum();
    let often = repeats.len() >= MIN_HELD_SAMPLES && repeats.len() as f64 >= 3.0 * (chance + chance.sqrt());
    if !often || where_slow(&channel.values, &repeats, &by_chance) < SLOW_REPEATS {
        return None;
    }
    for &k in &repeats {
        channel.good[k] = false;
    }
    // A slower sensor repeats its value at every second or third step: that is its rate, not a held sample.
    let mut distances: Vec<usize> = repeats.windows(2).map(|w| w[1] - w[0]).collect();
    distances.sort_unstable();
    let common = distances.get(distances.len() / 2).copied().unwrap_or(0);
    let regular = distances.iter().filter(|d| **d == common).count() * 10 > distances.len() * 9;
    // Samples are lost here and there; what stands still once is at rest, or stuck.
    let stretches = repeats.chunk_by(|a, b| a + 1 == *b).count();
    let longest = longest_run(&repeats);
    let stands = stretches < MIN_HELD_SAMPLES || longest * 2 > repeats.len() && longest > 20;
    if regular && fraction > 0.3 || stands {
        return None;
    }
    let (low, high) = share_interval(repeats.len() as f64, n as f64);
    let lost = |share: f64| (share - chance / n as f64).max(0.0);
    let parameters = BTreeMap::from([("fraction", (lost(fraction), lost(low), lost(high)))]);
    Some(SampleEffect { kind: Kind::Dropouts, channel: index, parameters, samples: repeats.len() })
}

/// Probability that repeats at the given samples have nothing to do with the motion, against repeats where it is slow: what a
/// link loses, it loses whatever the sensor measures, while what rests, or is rounded before it is corrected for something
/// else, repeats where it hardly moves. The change across each stretch of repeats has a rank among all changes over as many
/// steps, and ranks are equally likely; their mean is nearly normal (Wilcoxon, Biometrics 1, 1945). Known rounding repeats
/// neighbours with the probabilities `by_chance`, which accounts for some of the low ranks.
fn where_slow(values: &[f64], repeats: &[usize], by_chance: &[f64]) -> f64 {
    let change = |from: usize, steps: usize| (values[from + steps] - values[from]).abs();
    let mut sorted: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    // The rank of the change between two samples, from 0 to 1.
    let mut rank = |before: usize, after: usize| {
        let steps = after - before;
        let all = sorted.entry(steps).or_insert_with(|| {
            let mut all: Vec<f64> =
                (0..values.len() - steps).map(|k| change(k, steps)).filter(|c| c.is_finite()).collect();
            all.sort_unstable_by(f64::total_cmp);
            all
        });
        let own = change(before, steps);
        let (less, at_most) = (all.partition_point(|c| *c < own), all.partition_point(|c| *c <= own));
        (less + at_most) as f64 / (2 * all.len().max(1)) as f64
    };
    let stretches = repeats.chunk_by(|a, b| a + 1 == *b).map(|run| (run[0] - 1, run[run.len() - 1] + 1));
    let ends = values.len() - 1;
    let ranks: Vec<f64> =
        stretches.filter(|(_, after)| *after <= ends).map(|(before, after)| rank(before, after)).collect();
    let rounding =
        by_chance.iter().enumerate().filter(|(k, p)| **p > 0.0 && **p < RARE_REPEAT && k + 2 <= ends);
    let lower: f64 = rounding.map(|(k, p)| p * (0.5 - rank(k, k + 2))).sum();
    let n = ranks.len() as f64;
    let sigmas = (ranks.iter().map(|r| r - 0.5).sum::<f64>() + lower) / (n / 12.0).sqrt();
    if sigmas.is_finite() { Normal::standard().cdf(sigmas) } else { 1.0 }
}

/// Probability, for every pair of neighbours, that rounding makes them equal. The change within a pair is
/// normal, with the mean that the neighbouring changes predict and the spread of such prediction errors
/// around there: a motion is slow where it reverses, noise is not. Both values are rounded (Sheppard 1898),
/// so that they are equal with a probability that falls linearly to zero at a difference of one step.
fn repeats_by_chance(values: &[f64]) -> Vec<f64> {
    let tiny = SAME_VALUE * values.iter().filter(|v| v.is_finite()).fold(0.0f64, |peak, v| peak.max(v.abs()));
    let step = step_between_levels(values, tiny);
    let pairs = values.len().saturating_sub(1);
    if step == 0.0 {
        return vec![0.0; pairs];
    }
    let moved: Vec<(usize, f64)> = values
        .windows(2)
        .map(|w| w[1] - w[0])
        .enumerate()
        .filter(|(_, change)| change.abs() > tiny)
        .collect();
    // The mean of the nearest change before and after a pair.
    let beside = |k: usize| {
        let after = moved.partition_point(|(i, _)| *i <= k);
        let before = moved[..after].iter().rev().find(|(i, _)| *i < k);
        0.5 * (before.map_or(0.0, |m| m.1) + moved.get(after).map_or(0.0, |m| m.1))
    };
    let foretold: Vec<f64> = moved.iter().map(|(k, _)| beside(*k)).collect();
    // Persistence of the change, by least squares: one for a smooth motion, zero for a random walk.
    let kept = moved.iter().zip(&foretold).map(|((_, d), f)| d * f).sum::<f64>()
        / foretold.iter().map(|f| f * f).sum::<f64>().max(f64::MIN_POSITIVE);
    let missed: Vec<f64> = moved.iter().zip(&foretold).map(|((_, d), f)| d - kept * f).collect();
    let equal = |k: usize| {
        let at = moved.partition_point(|(i, _)| *i < k);
        let own = usize::from(moved.get(at).is_some_and(|(i, _)| *i == k));
        let near = [
            &missed[at.saturating_sub(NEIGHBOURS)..at],
            &missed[(at + own).min(missed.len())..(at + own + NEIGHBOURS).min(missed.len())],
        ]
        .concat();
        if near.is_empty() {
            return 1.0;
        }
        // Rounding both values adds a variance of step^2 / 6 to the observed differences.
        let std = (rms(&near).powi(2) - step * step / 6.0).max(0.0).sqrt();
        within_a_step(kept * beside(k), std, step)
    };
    (0..pairs).map(equal).collect()
}

/// Mean, over a normally distributed difference, of a triangle that is 1 at a difference of 0 and falls
/// linearly to 0 at `step` on both sides.
fn within_a_step(mean: f64, std: f64, step: f64) -> f64 {
    let normal = Normal::standard();
    // Mean of the positive part of `x` plus that noise; the triangle is its second difference.
    let above = |x: f64| {
        if std > 0.0 { x * normal.cdf(x / std) + std * normal.pdf(x / std) } else { x.max(0.0) }
    };
    ((above(mean + step) - 2.0 * above(mean) + above(mean - step)) / step).clamp(0.0, 1.0)
}

/// The smallest distance between values that repeat and come back later, 0 where none do: a rounded sensor returns to its
/// levels, what a continuous one holds it never measures again. Interpolated values between rounded ones repeat by
/// chance: values that repeat far less often than usual are left out.
fn step_between_levels(values: &[f64], tiny: f64) -> f64 {
    let equal = |a: f64, b: f64| (a - b).abs() <= tiny;
    // Once for every stretch of equal values: a vehicle at rest repeats its zeros as often as all other levels together.
    let mut repeated: Vec<f64> = (1..values.len())
        .filter(|&k| equal(values[k], values[k - 1]) && (k == 1 || !equal(values[k - 1], values[k - 2])))
        .map(|k| values[k])
        .collect();
    repeated.sort_unstable_by(f64::total_cmp);
    let begins = |k: usize| k == 0 || !equal(values[k], values[k - 1]);
    let mut stretches: Vec<f64> = (0..values.len()).filter(|k| begins(*k)).map(|k| values[k]).collect();
    stretches.sort_unstable_by(f64::total_cmp);
    let comes_back = |value: f64| {
        let from = stretches.partition_point(|v| *v < value - tiny);
        stretches[from..].iter().take_while(|v| **v <= value + tiny).nth(1).is_some()
    };
    let levels: Vec<&[f64]> =
        repeated.chunk_by(|a, b| b - a <= tiny).filter(|level| comes_back(level[0])).collect();
    // Total number of occurrences of each repeating value, one entry per occurrence.
    let times: Vec<f64> = levels.iter().flat_map(|l| vec![l.len() as f64; l.len()]).collect();
    if levels.len() < MIN_LEVELS {
        return 0.0;
    }
    let usual = median(&times);
    let often: Vec<f64> =
        levels.iter().filter(|l| l.len() as f64 >= OFTEN_SHARE * usual).map(|l| l[0]).collect();
    let least = often.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    const SAMPLES: usize = 4000;

    /// A gyroscope that hardly moves half of the time and turns fast in the other half; every `lost`-th
    /// sample repeats the one before.
    fn channel(step: f64, lost: Option<usize>) -> Channel {
        let mut stream = Stream::new(5, "held");
        let mut value = 0.0;
        let mut values: Vec<f64> = Vec::new();
        for k in 0..SAMPLES {
            let change = if k < SAMPLES / 2 { 0.2 } else { 8.0 };
            value = 0.98 * value + change * stream.normal();
            let repeats = lost.is_some_and(|every| k % every == every - 1);
            values.push(if repeats { values[k - 1] } else { (value / step).round() * step });
        }
        of_values(values)
    }

    fn of_values(values: Vec<f64>) -> Channel {
        Channel {
            output: 0,
            stride: 1,
            first: 0,
            good: vec![true; values.len()],
            values,
            early: Vec::new(),
            declared: 0.0,
        }
    }

    /// The held samples of the first channel, of which none is known to be at rest.
    fn lost(channel: &mut Channel) -> Option<SampleEffect> {
        let rests = vec![false; channel.values.len()];
        held((0, channel), &rests)
    }

    #[test]
    fn a_rounded_sensor_that_hardly_moves_has_lost_nothing() {
        for step in [0.25, 1.0] {
            assert_eq!(lost(&mut channel(step, None)), None, "{step}");
            // The logger resamples the sensor from another clock by linear interpolation.
            let mut stream = Stream::new(7, "clock");
            let mut jittered = channel(step, None);
            let samples = jittered.values.clone();
            for (value, two) in jittered.values.iter_mut().zip(samples.windows(2)) {
                let share = 0.5 * stream.uniform();
                *value = (1.0 - share) * two[0] + share * two[1];
            }
            assert_eq!(lost(&mut jittered), None, "{step}, interpolated");
        }
    }

    #[test]
    fn a_rounded_sensor_that_rests_between_its_motions_has_lost_nothing() {
        let mut stream = Stream::new(9, "rest");
        let mut flight = channel(1.0, None);
        // The logger resamples the sensor from another clock by linear interpolation.
        let angle = |k: usize| 20.0 * (std::f64::consts::TAU * k as f64 / 200.0).sin();
        let rounded: Vec<f64> = (0..=SAMPLES)
            .map(|k| if (k / 250) % 2 == 0 { 0.0 } else { (angle(k) + 0.4 * stream.normal()).round() })
            .collect();
        for (value, two) in flight.values.iter_mut().zip(rounded.windows(2)) {
            let share = 0.5 * stream.uniform();
            *value = (1.0 - share) * two[0] + share * two[1];
        }
        assert_eq!(lost(&mut flight), None);
    }

    /// A vane is read in steps, and what a rate adds to it moves with every sample: no value ever comes back.
    #[test]
    fn a_rounded_sensor_that_is_corrected_afterwards_has_lost_nothing() {
        let mut stream = Stream::new(13, "vane");
        let values: Vec<f64> = (0..800)
            .map(|k| {
                let moves = if k % 400 < 150 { 20.0 } else { 2.5 };
                let vane = (moves * (k as f64 * 0.1).sin() + 0.4 * stream.normal()).round();
                vane + 0.001 * (100.0 * (k as f64 * 0.07).sin()).round()
            })
            .collect();
        let repeats = values.windows(2).filter(|w| w[0] == w[1]).count();
        assert!(repeats >= 20, "{repeats}");
        assert_eq!(lost(&mut of_values(values)), None);
    }

    /// One stretch of repeats, however long.
    #[test]
    fn a_rest_before_a_motion_is_not_lost() {
        let motion = |k: usize| if k < 20 { 0.0 } else { ((k - 20) as f64 * 0.05).sin() };
        assert_eq!(lost(&mut of_values((0..250).map(motion).collect())), None);
    }

    /// Few lost samples of a sensor whose values all differ: what it holds are no levels of a rounding.
    #[test]
    fn lost_samples_of_a_sensor_that_is_not_rounded_are_counted() {
        let mut stream = Stream::new(11, "lost");
        let mut values: Vec<f64> =
            (0..800).map(|k| (k as f64 * 0.02).sin() + 0.05 * stream.normal()).collect();
        let gone: Vec<usize> = (20..800).step_by(40).collect();
        gone.iter().for_each(|k| values[*k] = values[k - 1]);
        let found = lost(&mut of_values(values)).unwrap();
        assert_eq!(found.samples, gone.len());
    }

    #[test]
    fn samples_that_are_lost_while_the_sensor_moves_are_counted() {
        for step in [1e-9, 0.01, 0.25] {
            let mut channel = channel(step, Some(25));
            let (_, low, high) = lost(&mut channel).unwrap().parameters["fraction"];
            assert!(low < 0.04 && 0.04 < high, "{step}: {low} to {high}");
        }
    }
}
