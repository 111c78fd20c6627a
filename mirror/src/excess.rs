//! Changes that no deterministic simulation reproduces: more noise, a tone, repeated values. Their likelihood
//! follows from the innovations.

use whirlstand_vehicle::{Effect, Kind};

use crate::bank::Bank;
use crate::capture::Capture;
use crate::finding::Value;
use crate::known::Knowledge;
use crate::predictor::Predictor;
use crate::replay::{Belief, predictor};

/// Share of repeated values above which their effect on the filter is examined.
const LEAST_SHARE: f64 = 0.2;

/// Largest number of samples in which a tone is searched; the last ones are used.
const TONE_SAMPLES: usize = 1024;

/// A cause with its parameters and its evidence.
#[derive(Debug, Clone)]
pub struct Excess {
    pub effect: Effect,
    pub values: Vec<Value>,
    /// Log-likelihood ratio against no change.
    pub evidence: f64,
    /// Number of estimated parameters.
    pub parameters: usize,
    /// Number of samples used.
    pub samples: u64,
}

fn value(name: &'static str, value: f64, spread: f64) -> Value {
    Value { name, value, low: value - 1.96 * spread, high: value + 1.96 * spread }
}

/// Noise, tones and dropouts of all outputs from step `from` to `to`.
pub fn all(known: &Knowledge, like: &Predictor, capture: &Capture, from: u64, to: u64) -> Vec<Excess> {
    let mut found = Vec::new();
    let mut series = Vec::new();
    for (output, declared) in known.vehicle.outputs.iter().enumerate() {
        series.clear();
        let fresh = (from..to).filter(|k| capture.sample(*k).fresh >> output & 1 == 1);
        series.extend(fresh.map(|k| (k, capture.whitened(k)[output])));
        if series.len() < 8 {
            continue;
        }
        let sigma = known.noise[output];
        found.extend(noise(&declared.name, &series, sigma));
        found.extend(tone(&declared.name, &series, sigma, known.period_s));
        found.extend(repeats(known, like, capture, output, &series));
    }
    found
}

/// Log-likelihood ratio of the clearest change that the bank still detects once this one is removed from the
/// innovations; 0 without one.
pub fn left(
    known: &Knowledge,
    capture: &Capture,
    excess: &Excess,
    from: u64,
    to: u64,
    mut bank: Bank,
) -> f64 {
    let effect = &excess.effect;
    let Some(output) = known.vehicle.output_index(effect.place()) else { return f64::INFINITY };
    let get = |name: &str| effect.parameter(name).unwrap_or(0.0);
    let sigma = known.noise[output];
    let scale = 1.0 / (1.0 + (get("std") / sigma).powi(2)).sqrt();
    let turn = std::f64::consts::TAU * get("frequency_hz") * known.period_s;
    let repeats = effect.kind() == Kind::Dropouts;
    // A tone is removed only in the range where it was fitted.
    let from = if effect.kind() == Kind::Vibration {
        from.max(to.saturating_sub(TONE_SAMPLES as u64))
    } else {
        from
    };
    bank.restart(from);
    let mut rest = vec![0.0; known.noise.len()];
    let mut values = rest.clone();
    let detected = (from..to).filter_map(|step| {
        let sample = capture.sample(step);
        rest.copy_from_slice(capture.whitened(step));
        values.copy_from_slice(sample.y);
        rest[output] = match effect.kind() {
            Kind::Noise => scale * rest[output],
            Kind::Vibration => {
                rest[output] - get("amplitude") / sigma * (turn * step as f64 + get("phase_rad")).sin()
            }
            _ => 0.0,
        };
        // The prediction errors from repeated values also appear in the other outputs.
        let fresh = if repeats { 0 } else { sample.fresh };
        if repeats {
            rest.fill(0.0);
        }
        bank.step(step, &rest, &values, fresh)
    });
    detected.map(|alarm| alarm.evidence).fold(0.0, f64::max)
}

/// Additional noise beyond the declared noise, estimated from the variance of the innovations.
fn noise(place: &str, series: &[(u64, f64)], sigma: f64) -> Option<Excess> {
    let count = series.len() as f64;
    let variance = series.iter().map(|(_, e)| e * e).sum::<f64>() / count;
    if variance <= 1.0 {
        return None;
    }
    let std = sigma * (variance - 1.0).sqrt();
    // The relative standard deviation of the variance is sqrt(2 / n).
    let spread = sigma * variance * (2.0 / count).sqrt() / (2.0 * (variance - 1.0).sqrt());
    Some(Excess {
        effect: Effect::new(Kind::Noise, place, &[("std", std)]).ok()?,
        values: vec![value("std", std, spread)],
        evidence: 0.5 * count * (variance - 1.0 - variance.ln()),
        parameters: 1,
        samples: series.len() as u64,
    })
}

/// A tone, estimated at the maximum of the periodogram.
fn tone(place: &str, series: &[(u64, f64)], sigma: f64, period_s: f64) -> Option<Excess> {
    let last = &series[series.len().saturating_sub(TONE_SAMPLES)..];
    let count = last.len();
    let (mut best, mut at) = (0.0, (0.0, 0.0, 0.0));
    let power = |w: f64| {
        let (step_sine, step_cosine) = w.sin_cos();
        let (mut sine, mut cosine) = (0.0, 1.0);
        let (mut a, mut b) = (0.0, 0.0);
        for (_, e) in last {
            a += e * sine;
            b += e * cosine;
            (sine, cosine) =
                (sine * step_cosine + cosine * step_sine, cosine * step_cosine - sine * step_sine);
        }
        (a, b)
    };
    let spacing = (last[count - 1].0 - last[0].0) as f64 / (count - 1) as f64;
    // The frequencies are half a line apart; a tone with fewer than three periods in the window counts as a
    // drift.
    for k in 6..count {
        let w = std::f64::consts::PI * k as f64 / count as f64;
        let (a, b) = power(w);
        if a * a + b * b > best {
            (best, at) = (a * a + b * b, (w, a, b));
        }
    }
    // Refine between the lines, where the power is a parabola near its maximum.
    let (mut w, mut width) = (at.0, std::f64::consts::FRAC_PI_4 / count as f64);
    for _ in 0..12 {
        for candidate in [w - width, w + width] {
            let (a, b) = power(candidate);
            if a * a + b * b > best {
                (best, at, w) = (a * a + b * b, (candidate, a, b), candidate);
            }
        }
        width *= 0.5;
    }
    let n = count as f64;
    let amplitude = 2.0 * best.sqrt() / n;
    let frequency_hz = at.0 / (std::f64::consts::TAU * period_s * spacing);
    // The phase of a sin + b cos at the first sample, extrapolated to the start of the flight.
    let there = at.2.atan2(at.1);
    let phase = there - std::f64::consts::TAU * frequency_hz * period_s * last[0].0 as f64;
    let phase = phase.rem_euclid(std::f64::consts::TAU);
    let parameters = [("frequency_hz", frequency_hz), ("amplitude", sigma * amplitude), ("phase_rad", phase)];
    // Cramer-Rao bounds for a tone in white noise (Rife and Boorstyn, IEEE Trans. Inf. Theory 20, 1974).
    let ratio = 0.5 * amplitude * amplitude;
    let frequency = (6.0 / (ratio * n * n * n)).sqrt() / (std::f64::consts::TAU * period_s * spacing);
    Some(Excess {
        effect: Effect::new(Kind::Vibration, place, &parameters).ok()?,
        values: vec![
            value("frequency_hz", frequency_hz, frequency),
            value("amplitude", sigma * amplitude, sigma * (2.0 / n).sqrt()),
        ],
        evidence: best / n,
        parameters: 3,
        samples: count as u64,
    })
}

/// Dropouts, from the share of repeated values.
fn repeats(
    known: &Knowledge,
    like: &Predictor,
    capture: &Capture,
    output: usize,
    series: &[(u64, f64)],
) -> Option<Excess> {
    let y = |k: u64| capture.sample(k).y[output];
    let pairs = series.windows(2).filter(|w| w[1].0 == w[0].0 + 1 || known.vehicle.outputs[output].every > 1);
    let (mut count, mut same) = (0.0, 0.0);
    for w in pairs {
        count += 1.0;
        same += f64::from(u8::from(y(w[0].0) == y(w[1].0)));
    }
    let anyway = anyway(known)[output];
    let share: f64 = same / count;
    if same < 2.0 || share <= anyway {
        return None;
    }
    let (p, q) = (anyway.max(1e-6), share);
    let rest = if q < 1.0 { (1.0 - q) * ((1.0 - q) / (1.0 - p)).ln() } else { 0.0 };
    let (from, to) = (series.first()?.0, series.last()?.0 + 1);
    let wrong =
        if share > LEAST_SHARE { not_measured(known, like, capture, output, (from, to)) } else { 0.0 };
    let spread = (q * (1.0 - q) / count).sqrt();
    Some(Excess {
        effect: dropouts(known, output, share)?,
        values: vec![Value {
            name: "fraction",
            value: share,
            low: (q - 1.96 * spread).max(0.0),
            high: (q + 1.96 * spread).min(1.0),
        }],
        evidence: count * (q * (q / p).ln() + rest) + wrong.max(0.0),
        parameters: 1,
        samples: series.len() as u64,
    })
}

fn dropouts(known: &Knowledge, output: usize, share: f64) -> Option<Effect> {
    Effect::new(Kind::Dropouts, &known.vehicle.outputs[output].name, &[("fraction", share)]).ok()
}

/// The evidence for ignoring repeated values as measurements, as a log-likelihood ratio: from the innovations of
/// this output, and from those of all other outputs, which the filter distorts when it uses repeated values.
fn not_measured(
    known: &Knowledge,
    like: &Predictor,
    capture: &Capture,
    output: usize,
    (from, to): (u64, u64),
) -> f64 {
    let plain = dropouts(known, output, 1.0)
        .and_then(|effect| predictor(known, like, capture, &Belief { effect, since: from, stood: None }));
    let Some(mut without) = plain else { return 0.0 };
    let squares = |e: &[f64]| e.iter().map(|v| v * v).sum::<f64>();
    let (mut last, mut sum) = (f64::NAN, 0.0);
    for step in from..to {
        let mut sample = capture.sample(step);
        let again = sample.fresh >> output & 1 == 1 && sample.y[output] == last;
        last = sample.y[output];
        if again {
            sample.fresh &= !(1 << output);
        }
        without.step(&sample);
        // Where the repeated value is no measurement, noise would have contributed an expected square of one.
        sum += squares(capture.whitened(step)) - squares(without.whitened()) - f64::from(u8::from(again));
    }
    0.5 * sum
}

/// Probability, for each output, that a value equals the one before without any change: two rounded values
/// with different noise are equal with probability q / (2 sigma sqrt(pi)) for the quantization step q. A
/// sensor without noise may be constant at any time, and so may values that a link [rounds](crate::rounding).
pub fn anyway(known: &Knowledge) -> Vec<f64> {
    let vehicle = &known.vehicle;
    let of = |(o, rounded): (&whirlstand_vehicle::Output, &bool)| {
        let at = |kind: Kind| vehicle.effects.iter().filter(move |e| e.kind() == kind && e.place() == o.name);
        let steps = at(Kind::Quantization).filter_map(|e| e.parameter("step"));
        let step = steps.fold(o.quantization, f64::max);
        let dropped: f64 = at(Kind::Dropouts).filter_map(|e| e.parameter("fraction")).sum();
        let limited = at(Kind::OutputSaturation).next().is_some();
        if o.noise <= 0.0 || limited || *rounded {
            return 1.0;
        }
        (step / (2.0 * o.noise * std::f64::consts::PI.sqrt()) + dropped).min(1.0)
    };
    vehicle.outputs.iter().zip(&known.rounded).map(of).collect()
}
