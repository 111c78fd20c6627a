//! Effects on single samples that need no model: rounding, clipping, held values and outliers.
//!
//! Samples that are not what the sensor would have delivered are excluded from everything that follows.

use crate::thresholds::{COARSE_STEP_SHARE, MIN_HELD_SAMPLES, MIN_STEPS_OF_A_LIMIT, NEIGHBOURS};
use std::collections::BTreeMap;

use whirlstand_vehicle::{Kind, Output, Vehicle};

use crate::data::held_samples::held;
use crate::data::record::{Channel, Data};
use crate::data::rests::at_rest;
use crate::data::sample_effect::SampleEffect;
use whirlstand_logs::rounding_step;
use whirlstand_logs::stats::{mad_std, median};

/// Finds rounding, clipping and held samples in the measurements, and excludes the affected samples.
pub fn measured_effects(data: &mut Data, vehicle: &Vehicle) -> Vec<SampleEffect> {
    let mut found = Vec::new();
    let rests: Vec<Vec<bool>> = (0..data.channels.len()).map(|index| at_rest(data, index)).collect();
    for ((index, channel), rests) in data.channels.iter_mut().enumerate().zip(rests) {
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
        if let Some(effect) = clipping((index, channel), &rests, step, noise) {
            found.push(effect);
        }
        if step < COARSE_STEP_SHARE * noise
            && let Some(effect) = held((index, channel), &rests)
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
    rounding_step(&values, least).or_else(|| {
        let (first, last) = (*values.first()?, *values.last()?);
        let inside: Vec<f64> = values.iter().copied().filter(|v| *v > first && *v < last).collect();
        rounding_step(&inside, least)
    })
}

/// Clipping: values that pile up at the largest or the smallest one, other than at `rests`.
fn clipping(
    (index, channel): (usize, &mut Channel),
    rests: &[bool],
    step: f64,
    noise: f64,
) -> Option<SampleEffect> {
    let moving = || channel.values.iter().zip(rests).filter(|(v, rests)| v.is_finite() && !**rests);
    let finite = || channel.values.iter().copied().filter(|v| v.is_finite());
    let (top, bottom) = (finite().fold(f64::NEG_INFINITY, f64::max), finite().fold(f64::INFINITY, f64::min));
    let width = (top - bottom).abs();
    if width.is_nan() || width <= 0.0 || width < MIN_STEPS_OF_A_LIMIT * step {
        return None;
    }
    let near = 1e-9 * width;
    let piled = |at: f64, inward: f64| {
        let count = moving().filter(|(v, _)| (*v - at).abs() <= near).count();
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
    let all = channel.values.iter().zip(&smooth).zip(&mut channel.good).zip(rests);
    for ((value, smooth), good) in all.filter(|(_, rests)| !**rests).map(|(sample, _)| sample) {
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
