//! Evidence curves of random causes: turbulence, narrow-band noise, excess noise, and faulty samples.

use crate::thresholds::{HISTOGRAM_BUCKETS, SAMPLES_SHOWN};
use std::f64::consts::TAU;
use whirlstand_logs::shown::ShownUnit;

use whirlstand_vehicle::{Kind, Vehicle};

use crate::answer::curves::ends;
use crate::answer::schema::{Axis, EvidenceCurve};
use crate::data::record::Data;
use crate::data::sample_effect::SampleEffect;
use crate::model::input_reconstruction::{Entry, reconstruct};
use crate::residual::narrow_band::NarrowBand;
use crate::residual::turbulence::Turbulence;
use crate::stages::findings::Findings;
use whirlstand_logs::spectrum::welch;
use whirlstand_logs::stats::rms;

/// Spectrum of the force missing on a state, against the spectrum of the named turbulence.
pub(crate) fn turbulence(
    found: &Turbulence,
    findings: &Findings<'_>,
    data: &Data,
    vehicle: &Vehicle,
    noise: &[f64],
) -> Option<EvidenceCurve> {
    let residual = &findings.residual.selection.fit.residual;
    // How fast the unknown force changes is estimated from the residual itself; its noise shows as the floor
    // of the spectrum.
    let traced = reconstruct(vehicle, data, Entry::State(found.state), &vec![0.0; noise.len()], &[residual])?;
    let spectrum = welch(&traced[0], data.period_s);
    let f: Vec<f64> = spectrum.frequency_hz.iter().skip(1).copied().collect();
    let measured = spectrum.density.iter().skip(1).map(|d| d.sqrt()).collect();
    let (std, a) = (found.std.0, TAU * found.bandwidth_hz.0);
    let density = |f: &f64| (4.0 * std * std * a / (a * a + (TAU * f).powi(2))).sqrt();
    let state = &vehicle.states[found.state];
    Some(EvidenceCurve {
        cause: format!("{} on {}", Kind::Turbulence, state.name),
        accepted: true,
        caption: "A force that is independent of the inputs, flat up to its bandwidth and falling beyond; the rise at high frequency is sensor noise.".into(),
        x: Axis::new("frequency", ShownUnit::si("Hz")),
        y: Axis::new(&format!("missing part of the derivative of {}", state.name), state.unit.shown().per_second().per_root_hertz()),
        logarithmic: true,
        explained: (f.clone(), f.iter().map(density).collect()),
        measured: (f, measured),
        ..EvidenceCurve::default()
    })
}

/// Spectrum of the final residual around a line of varying frequency.
pub(crate) fn narrow_band(
    found: &NarrowBand,
    findings: &Findings<'_>,
    data: &Data,
    vehicle: &Vehicle,
) -> EvidenceCurve {
    let channel = &data.channels[found.channel];
    let output = &vehicle.outputs[channel.output];
    let residual = &findings.residual.selection.fit.residual[data.ranges()[found.channel].clone()];
    let spectrum = welch(residual, data.period_s * channel.stride as f64);
    let f: Vec<f64> = spectrum.frequency_hz.iter().skip(1).copied().collect();
    let measured = spectrum.density.iter().skip(1).map(|d| d.sqrt()).collect();
    let (middle, spread) = (found.frequency_hz.0, found.wander_hz);
    let height = 0.5 * found.amplitude.0.powi(2) / (spread * TAU.sqrt());
    let line = |f: &f64| (found.floor + height * (-0.5 * ((f - middle) / spread).powi(2)).exp()).sqrt();
    EvidenceCurve {
        cause: format!("{} on {}", Kind::Vibration, output.name),
        accepted: true,
        caption: "A line far above the spectrum around it, wider than that of a tone and narrower than any resonance of the noise."
            .into(),
        x: Axis::new("frequency", ShownUnit::si("Hz")),
        y: Axis::new(&format!("residual of {}", output.name), output.unit.shown().per_root_hertz()),
        logarithmic: true,
        explained: (f.clone(), f.iter().map(line).collect()),
        measured: (f, measured),
        ..EvidenceCurve::default()
    }
}

/// Histogram of the final residual, against the declared noise; beside a filter, whose residual has motions, of its changes
/// from sample to sample over the root of two, which of white noise have its standard deviation.
pub(crate) fn noise(
    channel: usize,
    findings: &Findings<'_>,
    data: &Data,
    vehicle: &Vehicle,
) -> EvidenceCurve {
    let range = data.ranges()[channel].clone();
    let good = &data.channels[channel].good;
    let residual = &findings.residual.selection.fit.residual[range];
    let follows = data.memory_s.is_some();
    let values: Vec<f64> = if follows {
        let both = residual.windows(2).zip(good.windows(2)).filter(|(_, good)| good[0] && good[1]);
        both.map(|(r, _)| (r[1] - r[0]) / std::f64::consts::SQRT_2).filter(|v| v.is_finite()).collect()
    } else {
        residual.iter().zip(good).filter(|(_, g)| **g).map(|(r, _)| *r).collect()
    };
    let shown = if follows { "changes of the residual" } else { "residual" };
    let output = &vehicle.outputs[data.channels[channel].output];
    let (std, reach) = (rms(&values), 4.0 * rms(&values));
    let width = 2.0 * reach / HISTOGRAM_BUCKETS as f64;
    let centres: Vec<f64> = (0..HISTOGRAM_BUCKETS).map(|b| (b as f64 + 0.5) * width - reach).collect();
    let mut counts = vec![0.0; HISTOGRAM_BUCKETS];
    for v in &values {
        let bucket = ((v + reach) / width).floor();
        if (0.0..HISTOGRAM_BUCKETS as f64).contains(&bucket) {
            counts[bucket as usize] += 1.0;
        }
    }
    let bell = |std: f64| {
        let height = values.len() as f64 * width / (std.max(f64::MIN_POSITIVE) * TAU.sqrt());
        centres.iter().map(|c| height * (-0.5 * (c / std).powi(2)).exp()).collect::<Vec<f64>>()
    };
    EvidenceCurve {
        cause: format!("{} on {}", Kind::Noise, output.name),
        accepted: true,
        caption: if follows {
            "Changes from sample to sample, over the root of two, are larger than the declared noise makes them."
        } else {
            "The residual has a bell-shaped distribution, wider than the declared noise."
        }
        .into(),
        x: Axis::new(&format!("{shown} of {}", output.name), output.unit.shown()),
        y: Axis::number("samples"),
        explained: (centres.clone(), bell(std)),
        without: (centres.clone(), bell(output.noise)),
        measured: (centres, counts),
        ..EvidenceCurve::default()
    }
}

/// Faulty samples of a channel among their neighbours.
pub(crate) fn samples(effect: &SampleEffect, data: &Data, vehicle: &Vehicle) -> Option<EvidenceCurve> {
    let channel = &data.channels[effect.channel];
    let output = &vehicle.outputs[channel.output];
    let wrong = |k: usize| match effect.kind {
        Kind::Dropouts => k > 0 && channel.values[k] == channel.values[k - 1],
        Kind::Quantization => false,
        _ => !channel.good[k],
    };
    let n = channel.values.len();
    let around = SAMPLES_SHOWN.min(n);
    let count = |from: usize| (from..from + around).filter(|k| wrong(*k)).count();
    let from = (0..=n - around).step_by((around / 4).max(1)).max_by_key(|from| count(*from))?;
    let mut part = from..from + around;
    if effect.kind == Kind::Quantization {
        // Rounding steps are easiest to see in the window with the smallest range.
        let spread = |from: usize| {
            let (low, high) = ends(&channel.values[from..from + around / 4]);
            high - low
        };
        let starts = (0..=n - around).step_by((around / 4).max(1));
        let from = starts.min_by(|a, b| spread(*a).total_cmp(&spread(*b)))?;
        part = from..from + around / 4;
    }
    let t = |k: usize| data.start_s + channel.step(k) as f64 * data.period_s;
    let marked: Vec<usize> = part.clone().filter(|k| wrong(*k)).collect();
    let caption = match effect.kind {
        Kind::Dropouts => "Marked samples repeat the previous one exactly.",
        Kind::Quantization => "The values lie on discrete levels.",
        Kind::OutputSaturation => "The values stay at a limit.",
        _ => "Marked samples are far from their neighbours.",
    };
    Some(EvidenceCurve {
        cause: format!("{} on {}", effect.kind, output.name),
        accepted: true,
        caption: caption.into(),
        x: Axis::time("time"),
        y: Axis::new(&output.name, output.unit.shown()),
        cloud: (marked.iter().map(|k| t(*k)).collect(), marked.iter().map(|k| channel.values[*k]).collect()),
        measured: (part.clone().map(t).collect(), channel.values[part].to_vec()),
        ..EvidenceCurve::default()
    })
}
