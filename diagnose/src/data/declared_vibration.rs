//! Vibrations that the vehicle file declares for a sensor: these are known and not a finding.

use crate::thresholds::{DECLARED_AMPLITUDE_RATIO, DECLARED_FREQUENCY_LINES};
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;
use whirlstand_vehicle::{Engine, Vehicle};

use crate::data::record::Data;

/// Subtracts the declared vibrations from the measurements, with the phase and amplitude that the residual
/// shows, up to the declared amplitude: a vibration beyond that stays in the data and is found. Each record has its own: in
/// what is missing between two of them the phase went on by an unknown angle. Returns what is left of the residual, with gaps filled.
pub fn take_off(data: &mut Data, vehicle: &Vehicle, residual: &[f64]) -> Vec<f64> {
    let mut left = residual.to_vec();
    let (ranges, period_s) = (data.ranges(), data.period_s);
    let parts: Vec<Vec<Range<usize>>> = data.channels.iter().map(|c| data.parts(c).collect()).collect();
    for ((channel, range), parts) in data.channels.iter_mut().zip(ranges).zip(parts) {
        let Some(vibration) = &vehicle.outputs[channel.output].vibration else { continue };
        let size = vibration.amplitude(Engine::Flying);
        let known = channel.known().into_owned();
        for part in parts.into_iter().filter(|part| !part.is_empty()) {
            let rest = &mut left[range.clone()][part.clone()];
            let at = |k: usize| (k * channel.stride) as f64 * period_s;
            let duration_s = at(part.len());
            for (i, share) in vibration.harmonics.iter().enumerate() {
                let declared = (share * size).abs();
                if declared <= 0.0 {
                    continue;
                }
                let nominal = vibration.frequency_hz * (i + 1) as f64;
                let tones = (-4 * DECLARED_FREQUENCY_LINES..=4 * DECLARED_FREQUENCY_LINES).map(|line| {
                    let f = nominal + f64::from(line) * 0.25 / duration_s;
                    (f, tone(rest, &known[part.clone()], f, at))
                });
                let strongest = tones.max_by(|a, b| a.1.norm_squared().total_cmp(&b.1.norm_squared()));
                let Some((f, weights)) = strongest else { continue };
                let weights = weights
                    * (DECLARED_AMPLITUDE_RATIO * declared / weights.norm().max(f64::MIN_POSITIVE)).min(1.0);
                for (k, rest) in rest.iter_mut().enumerate() {
                    let (sine, cosine) = (std::f64::consts::TAU * f * at(k)).sin_cos();
                    let y = weights[0] * sine + weights[1] * cosine;
                    channel.values[part.start + k] -= y;
                    *rest -= y;
                }
            }
        }
    }
    data.fill(&mut left);
    left
}

/// Least-squares coefficients of sine and cosine at frequency `f`.
fn tone(rest: &[f64], good: &[bool], f: f64, at: impl Fn(usize) -> f64) -> Vector2<f64> {
    let (mut square, mut product) = (Matrix2::zeros(), Vector2::zeros());
    for (k, (r, _)) in rest.iter().zip(good).enumerate().filter(|(_, (_, good))| **good) {
        let (sine, cosine) = (std::f64::consts::TAU * f * at(k)).sin_cos();
        let wave = Vector2::new(sine, cosine);
        square += wave * wave.transpose();
        product += wave * *r;
    }
    square.try_inverse().map_or_else(Vector2::zeros, |inverse| inverse * product)
}
