//! Effects on single samples that need no model: rounding, clipping, held values and outliers.
//!
//! Samples that are not what the sensor would have delivered are excluded from everything that follows.

use crate::thresholds::{
    COARSE_STEP_SHARE, MIN_HELD_SAMPLES, MIN_LEVELS, MIN_STEPS_OF_A_LIMIT, NEIGHBOURS, NEW_VALUE_SHARE,
    OFTEN_SHARE, RARE_REPEAT,
};
use std::collections::BTreeMap;

use whirlstand_vehicle::{Kind, Output, Vehicle};

use crate::data::record::{Channel, Data};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};
use whirlstand_logs::stats::{mad_std, median, rms};

/// Values whose difference is at most this share of the largest are equal up to rounding of the arithmetic.
const SAME_VALUE: f64 = 1e-9;

/// An effect on single samples of a channel, such as rounding or clipping.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleEffect {
    /// Kind of the effect.
    pub kind: Kind,
    /// Index of the channel.
    pub channel: usize,
    /// Parameters by name: value, lower and upper end of the 95 % interval, SI.
    pub parameters: BTreeMap<&'static str, (f64, f64, f64)>,
    /// Number of samples affected.
    pub samples: usize,
}

/// Finds rounding, clipping and held samples in the measurements, and excludes the affected samples.
pub fn measured_effects(data: &mut Data, vehicle: &Vehicle) -> Vec<SampleEffect> {
    let mut found = Vec::new();
    for (index, channel) in data.channels.iter_mut().enumerate() {
        let output = &vehicle.outputs[channel.output];
        let noise = if output.noise > 0.0 { output.noise } else { fast_noise(channel) };
        let rounding =
            rounding(channel, COARSE_STEP_SHARE * noise).filter(|step| *step > 1.5 * output.quantization);
        let step = rounding.unwrap_or(output.quantization);
        if let Some(step) = rounding {
            let parameters = BTreeMap::from([("step", (step, step * (1.0 - 1e-3), step * (1.0 + 1e-3)))]);
            let samples = channel.values.len();
            found.push(SampleEffect { kind: Kind::Quantization, channel: index, parameters, samples });
        }
        if let Some(effect) = clipping(channel, index, step, noise) {
            found.push(effect);
        }
        if step < COARSE_STEP_SHARE * noise
            && let Some(effect) = held(channel, index)
        {
            found.push(effect);
        }
    }
    found
}

/// True when a sensor's values are multiples of a step that is coarser than its noise.
pub fn is_coarse(channel: &Channel, output: &Output) -> bool {
    let noise = if output.noise > 0.0 { output.noise } else { fast_noise(channel) };
    rounding(channel, noise).is_some()
}

/// Standard deviation of the sample-to-sample changes of a channel.
fn fast_noise(channel: &Channel) -> f64 {
    let differences: Vec<f64> = channel.values.windows(2).map(|w| w[1] - w[0]).collect();
    mad_std(&differences) / 2f64.sqrt()
}

/// The rounding step of which all values are multiples, if it is coarser than `least`. A limit that clips
/// them need not be a multiple.
fn rounding(channel: &Channel, least: f64) -> Option<f64> {
    let mut values: Vec<f64> = channel.values.iter().copied().filter(|v| v.is_finite()).collect();
    values.sort_unstable_by(f64::total_cmp);
    step_of(&values, least).or_else(|| {
        let (first, last) = (*values.first()?, *values.last()?);
        let inside: Vec<f64> = values.iter().copied().filter(|v| *v > first && *v < last).collect();
        step_of(&inside, least)
    })
}

/// The rounding step of sorted values, as in [`rounding`].
fn step_of(values: &[f64], least: f64) -> Option<f64> {
    let tiny = SAME_VALUE * values.last()?.abs().max(values.first()?.abs());
    let gaps: Vec<f64> = values.windows(2).map(|w| w[1] - w[0]).filter(|g| *g > tiny).collect();
    if gaps.len() < MIN_LEVELS - 1 || gaps.len() * 2 > values.len() {
        return None;
    }
    let smallest = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    if smallest < least {
        return None;
    }
    // Gaps are multiples of the step; the value farthest from zero determines more digits.
    let singles: Vec<f64> = gaps.iter().copied().filter(|g| *g < 1.5 * smallest).collect();
    let mut step = median(&singles);
    let far =
        if values[0].abs() > values[values.len() - 1].abs() { values[0] } else { values[values.len() - 1] };
    let multiple = (far / step).round();
    if multiple != 0.0 && multiple.abs() < 1e4 {
        let refined = far / multiple;
        if (refined / step - 1.0).abs() < 0.01 {
            step = refined;
        }
    }
    let on = values.iter().filter(|v| (*v / step - (*v / step).round()).abs() < 0.02).count();
    (on * 10 >= values.len() * 9).then_some(step)
}

/// Clipping: values that pile up at the largest or the smallest one.
fn clipping(channel: &mut Channel, index: usize, step: f64, noise: f64) -> Option<SampleEffect> {
    let finite = || channel.values.iter().copied().filter(|v| v.is_finite());
    let (top, bottom) = (finite().fold(f64::NEG_INFINITY, f64::max), finite().fold(f64::INFINITY, f64::min));
    let width = (top - bottom).abs();
    if width.is_nan() || width <= 0.0 || width < MIN_STEPS_OF_A_LIMIT * step {
        return None;
    }
    let near = 1e-9 * width;
    let piled = |at: f64, inward: f64| {
        let count = finite().filter(|v| (v - at).abs() <= near).count();
        // Rounded values repeat anyway: at a clipping limit they do so far more often than just inside it.
        let inside =
            finite().filter(|v| step > 0.0 && (v - (at + inward * step)).abs() <= 0.01 * step).count();
        count >= MIN_HELD_SAMPLES.max(channel.values.len() / 500) && count > 3 * inside
    };
    let (upper, lower) = (piled(top, -1.0), piled(bottom, 1.0));
    if !upper && !lower {
        return None;
    }
    // Near a limit the noise is clipped on one side: all samples near it are excluded, not only the clipped
    // ones.
    let smooth = smoothed(&channel.values);
    let mut samples = 0;
    for ((value, smooth), good) in channel.values.iter().zip(&smooth).zip(&mut channel.good) {
        let cut = upper && (value - top).abs() <= near || lower && (value - bottom).abs() <= near;
        samples += usize::from(cut);
        let close = upper && *smooth > top - 2.5 * noise || lower && *smooth < bottom + 2.5 * noise;
        *good &= !(cut || close);
    }
    // A limit that was not reached is anywhere beyond what was.
    let range = |at: f64, cut: bool, far: f64| {
        let beyond = at + 2.0 * far;
        if cut {
            (at, at - 1e-6 * width, at + 1e-6 * width)
        } else {
            (at + far, at.min(beyond), at.max(beyond))
        }
    };
    let parameters = BTreeMap::from([
        ("upper", range(top, upper, 10.0 * width)),
        ("lower", range(bottom, lower, -10.0 * width)),
    ]);
    Some(SampleEffect { kind: Kind::OutputSaturation, channel: index, parameters, samples })
}

/// Running median over nine samples.
fn smoothed(values: &[f64]) -> Vec<f64> {
    (0..values.len())
        .map(|k| median(&values[k.saturating_sub(NEIGHBOURS)..(k + NEIGHBOURS + 1).min(values.len())]))
        .collect()
}

/// Held samples: values that occasionally repeat the one before.
fn held(channel: &mut Channel, index: usize) -> Option<SampleEffect> {
    let by_chance = repeats_by_chance(&channel.values);
    // Where the signal hardly moves, a rounded value repeats anyway: a repeat is evidence only where the
    // signal moves.
    let n = by_chance.iter().filter(|p| **p < RARE_REPEAT).count() + 1;
    let repeats: Vec<usize> = (1..channel.values.len())
        .filter(|&k| {
            let same = channel.values[k] == channel.values[k - 1] && by_chance[k - 1] < RARE_REPEAT;
            same && channel.good[k] && channel.good[k - 1]
        })
        .collect();
    let fraction = repeats.len() as f64 / n as f64;
    if fraction > 1.0 - NEW_VALUE_SHARE {
        return None;
    }
    let chance: f64 = by_chance.iter().filter(|p| **p < RARE_REPEAT).sum();
    if repeats.len() < MIN_HELD_SAMPLES || (repeats.len() as f64) < 3.0 * (chance + chance.sqrt()) {
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
    let longest = longest_run(&repeats);
    if regular && fraction > 0.3 || longest * 2 > repeats.len() && longest > 20 {
        return None;
    }
    let (low, high) = share_interval(repeats.len() as f64, n as f64);
    let lost = |share: f64| (share - chance / n as f64).max(0.0);
    let parameters = BTreeMap::from([("fraction", (lost(fraction), lost(low), lost(high)))]);
    Some(SampleEffect { kind: Kind::Dropouts, channel: index, parameters, samples: repeats.len() })
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

/// 95 % interval of a proportion, `count` of `n` (Wilson).
pub(crate) fn share_interval(count: f64, n: f64) -> (f64, f64) {
    let z2 = 1.96f64 * 1.96;
    let centre = (count + 0.5 * z2) / (n + z2);
    let half = 1.96 * (count * (1.0 - count / n) + 0.25 * z2).sqrt() / (n + z2);
    ((centre - half).max(0.0), centre + half)
}

pub(crate) fn longest_run(sorted: &[usize]) -> usize {
    let (mut longest, mut run) = (0, 0);
    for (i, k) in sorted.iter().enumerate() {
        run = if i > 0 && sorted[i - 1] + 1 == *k { run + 1 } else { 1 };
        longest = longest.max(run);
    }
    longest
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
        Channel { output: 0, stride: 1, first: 0, good: vec![true; SAMPLES], values, declared: 0.0 }
    }

    #[test]
    fn a_rounded_sensor_that_hardly_moves_has_lost_nothing() {
        for step in [0.25, 1.0] {
            assert_eq!(held(&mut channel(step, None), 0), None, "{step}");
            // The logger resamples the sensor from another clock by linear interpolation.
            let mut stream = Stream::new(7, "clock");
            let mut jittered = channel(step, None);
            let samples = jittered.values.clone();
            for (value, two) in jittered.values.iter_mut().zip(samples.windows(2)) {
                let share = 0.5 * stream.uniform();
                *value = (1.0 - share) * two[0] + share * two[1];
            }
            assert_eq!(held(&mut jittered, 0), None, "{step}, interpolated");
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
        assert_eq!(held(&mut flight, 0), None);
    }

    /// Few lost samples of a sensor whose values all differ: what it holds are no levels of a rounding.
    #[test]
    fn lost_samples_of_a_sensor_that_is_not_rounded_are_counted() {
        let mut stream = Stream::new(11, "lost");
        let mut values: Vec<f64> =
            (0..800).map(|k| (k as f64 * 0.02).sin() + 0.05 * stream.normal()).collect();
        let lost: Vec<usize> = (20..800).step_by(40).collect();
        lost.iter().for_each(|k| values[*k] = values[k - 1]);
        let mut channel =
            Channel { output: 0, stride: 1, first: 0, good: vec![true; values.len()], values, declared: 0.0 };
        let found = held(&mut channel, 0).unwrap();
        assert_eq!(found.samples, lost.len());
    }

    #[test]
    fn samples_that_are_lost_while_the_sensor_moves_are_counted() {
        for step in [1e-9, 0.01, 0.25] {
            let mut channel = channel(step, Some(25));
            let (_, low, high) = held(&mut channel, 0).unwrap().parameters["fraction"];
            assert!(low < 0.04 && 0.04 < high, "{step}: {low} to {high}");
        }
    }
}
