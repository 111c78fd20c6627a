//! Shaking whose frequency wanders: a line in a residual's spectrum that no tone of one frequency explains.
//!
//! A rotor does not hold its speed, and a sensor that it shakes shows a narrow line rather than a tone. Resonant noise is
//! broader, and what the vehicle itself does is slower.

use whirlstand_vehicle::{Kind, Vehicle, Vibration};

use super::data::Data;
use super::model::Model;
use crate::spectrum::{peaks, welch};
use crate::stats::median;

/// A line of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shaking {
    /// Channel.
    pub channel: usize,
    /// Frequency, Hz, and half of its 95 % interval.
    pub frequency_hz: (f64, f64),
    /// Amplitude of a sine of the line's power, SI, and half of its 95 % interval.
    pub amplitude: (f64, f64),
    /// How far the frequency wanders: standard deviation, Hz.
    pub wander_hz: f64,
    /// Density of the floor about the line, SI squared per Hz.
    pub floor: f64,
    /// Share of the residual's power.
    pub share: f64,
    /// Twice the gain in Whittle's log-likelihood over a spectrum without the line.
    pub gain: f64,
}

/// Reach of a line to either side, as a share of the sampling rate,
const NARROW: f64 = 0.006;
/// and of its surroundings.
const WIDE: f64 = 0.03;
/// Share of the power in the surroundings that is in the line. Noise with a resonance of radius 0.95 has less than half.
const CONCENTRATED: f64 = 0.65;
/// Height over the floor.
const HIGH: f64 = 15.0;
/// Share of the residual's power from which on a line is named.
const WORTH: f64 = 0.005;
/// How much faster than the vehicle's fastest own motion it must be: slower lines may be limit cycles.
const FASTER: f64 = 5.0;
/// Lines of a channel that are looked at.
const MOST: usize = 3;
/// Lines of two channels that are nearer, as a share, are the same shaking.
const SAME: f64 = 0.02;

/// The strongest such line of every channel whose vibration the vehicle does not declare.
pub fn shaking(model: &Model<'_, '_>, residual: &[f64]) -> Vec<Shaking> {
    let data = model.runner.data;
    let vehicle = &model.runner.vehicle;
    let poles = vehicle.a.clone().complex_eigenvalues();
    let fastest = poles.iter().map(|p| p.norm()).fold(0.0, f64::max) / std::f64::consts::TAU;
    let channels = data.channels.iter().zip(data.ranges()).enumerate();
    channels
        .filter(|(_, (channel, _))| vehicle.outputs[channel.output].vibration.is_none())
        .filter_map(|(c, (channel, range))| {
            let place = &vehicle.outputs[channel.output].name;
            if model.terms.iter().any(|t| t.kind == Kind::Vibration && t.place == *place) {
                return None;
            }
            line(&residual[range], data.period_s * channel.stride as f64, FASTER * fastest)
                .map(|found| Shaking { channel: c, ..found })
        })
        .collect()
}

/// The strongest line above `lowest_hz`.
fn line(residual: &[f64], period_s: f64, lowest_hz: f64) -> Option<Shaking> {
    let spectrum = welch(residual, period_s);
    let df = *spectrum.frequency_hz.get(1)?;
    let total: f64 = spectrum.density.iter().sum::<f64>() * df;
    // The window alone makes a tone four bins wide.
    if 4.0 * df > 2.0 * NARROW / period_s {
        return None;
    }
    let around = |f: f64, from: f64, to: f64| -> Vec<(f64, f64)> {
        let reach = from / period_s..=to / period_s;
        let bins = spectrum.frequency_hz.iter().zip(&spectrum.density);
        bins.filter(|(g, _)| reach.contains(&(**g - f).abs())).map(|(g, d)| (*g, *d)).collect()
    };
    peaks(&spectrum, MOST).into_iter().find_map(|peak| {
        let surroundings: Vec<f64> =
            around(peak.frequency_hz, WIDE, 3.0 * WIDE).into_iter().map(|(_, d)| d).collect();
        if peak.frequency_hz < lowest_hz || surroundings.len() < 8 {
            return None;
        }
        let floor = median(&surroundings);
        let above = |d: f64| (d - floor).max(0.0);
        // A line that wanders is lopsided: its middle is not where it is highest.
        let f = {
            let near = around(peak.frequency_hz, 0.0, 2.0 * NARROW);
            let weight: f64 = near.iter().map(|(_, d)| above(*d)).sum();
            near.iter().map(|(g, d)| g * above(*d)).sum::<f64>() / weight
        };
        let line = around(f, 0.0, NARROW);
        let power = line.iter().map(|(_, d)| above(*d)).sum::<f64>() * df;
        let near = around(f, 0.0, WIDE).iter().map(|(_, d)| above(*d)).sum::<f64>() * df;
        let height = line.iter().fold(0.0f64, |m, (_, d)| m.max(*d));
        let share = power / total;
        if height < HIGH * floor || power < CONCENTRATED * near || share < WORTH {
            return None;
        }
        // Averages that do not depend on each other: those of the whole record, bin by bin.
        let averages = residual.len() as f64 * period_s * df;
        let gain = line.iter().map(|(_, d)| 2.0 * averages * (d / floor - 1.0 - (d / floor).ln()).max(0.0));
        let spread = line.iter().map(|(g, d)| (g - f).powi(2) * above(*d)).sum::<f64>() * df / power;
        let spread = spread.sqrt().max(0.5 * df);
        let looks = (residual.len() as f64 * period_s * spread).max(1.0);
        let amplitude = (2.0 * power).sqrt();
        Some(Shaking {
            channel: 0,
            frequency_hz: (f, 1.96 * spread / looks.sqrt()),
            amplitude: (amplitude, 1.96 * 0.5 * amplitude / looks.sqrt()),
            wander_hz: spread,
            floor,
            share,
            gain: gain.sum(),
        })
    })
}

/// The vehicle's output with it: a declared vibration, as its phase is no record's.
pub fn declare(vehicle: &mut Vehicle, data: &Data, found: &Shaking) {
    let amplitude = found.amplitude.0;
    vehicle.outputs[data.channels[found.channel].output].vibration = Some(Vibration {
        frequency_hz: found.frequency_hz.0,
        phase_rad: 0.0,
        harmonics: vec![1.0],
        off: 0.0,
        on: amplitude,
        flying: amplitude,
    });
}

/// True for lines of one shaking.
pub fn same(a: &Shaking, b: &Shaking) -> bool {
    (a.frequency_hz.0 - b.frequency_hz.0).abs() < SAME * a.frequency_hz.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    const PERIOD_S: f64 = 0.01;

    /// White noise behind a resonance of this radius at 27.6 Hz, of unit variance, in white noise of 0.1.
    fn resonant(seed: u64, radius: f64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "shaking");
        let angle = std::f64::consts::TAU * 27.6 * PERIOD_S;
        let (a, b) = (2.0 * radius * angle.cos(), -radius * radius);
        let (mut one, mut two) = (0.0, 0.0);
        let raw: Vec<f64> = (0..8000)
            .map(|_| {
                let next = a * one + b * two + stream.normal();
                (two, one) = (one, next);
                next
            })
            .collect();
        let size = crate::stats::rms(&raw);
        raw.iter().map(|v| v / size + 0.1 * stream.normal()).collect()
    }

    #[test]
    fn a_line_that_wanders_is_found_with_its_size() {
        for seed in 0..20 {
            let found = line(&resonant(seed, 0.993), PERIOD_S, 5.0).expect("a line");
            let (f, half) = found.frequency_hz;
            assert!((f - 27.6).abs() < 0.3 && half < 0.3, "{found:?}");
            assert!((found.amplitude.0 - 2f64.sqrt()).abs() < 0.35, "{found:?}");
            assert!(found.share > 0.7 && found.gain > 100.0, "{found:?}");
        }
    }

    #[test]
    fn resonant_noise_and_slow_lines_are_none() {
        for seed in 0..40 {
            assert_eq!(line(&resonant(seed, 0.95), PERIOD_S, 5.0), None, "{seed}");
            assert_eq!(line(&resonant(seed, 0.993), PERIOD_S, 30.0), None, "{seed}");
        }
    }
}
