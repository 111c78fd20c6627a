//! Vibrations of varying frequency: a line in a residual's spectrum that no tone of constant frequency
//! explains.
//!
//! A rotor's speed varies, so that a sensor that it shakes shows a narrow line rather than a tone. Noise
//! behind a resonance can have as narrow a line; but its envelope is Rayleigh distributed, whatever its
//! order, while that of a rotor is steady (Rice 1944). The vehicle's own motion is slower.

use crate::thresholds::{
    ABOVE_VEHICLE_RATIO, LINE_HEIGHT, LINE_REACH, LINE_RESIDUAL_SHARE, LINES_EXAMINED, SAME_LINE_SHARE,
    STEADY_SIGMAS, SURROUNDINGS_REACH,
};
use whirlstand_linalg::{C64, fft, spectral_radius};
use whirlstand_vehicle::{Kind, Vehicle, Vibration};

use crate::data::record::Data;
use crate::model::fit::Model;
use whirlstand_logs::spectrum::{Peak, peaks, welch};
use whirlstand_logs::stats::{mean, median};

/// A narrow spectral line of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NarrowBand {
    /// Index of the channel.
    pub channel: usize,
    /// Centre frequency, Hz, and half of its 95 % interval.
    pub frequency_hz: (f64, f64),
    /// Amplitude of a sine of the line's power, SI, and half of its 95 % interval.
    pub amplitude: (f64, f64),
    /// Standard deviation of the frequency, Hz.
    pub wander_hz: f64,
    /// Density of the noise floor around the line, SI squared per Hz.
    pub floor: f64,
    /// Share of the line in the residual's power.
    pub share: f64,
    /// Twice the gain in Whittle's log-likelihood over a spectrum without the line.
    pub gain: f64,
    /// True when the envelope is steadier than that of any noise.
    pub steady: bool,
}

/// The strongest narrow line of every channel whose vibration the vehicle does not declare. One rotor shakes
/// all sensors: where the envelope of its line is steady in one of them, the lines of the others are
/// attributed to it too.
pub fn narrow_band(model: &Model<'_, '_>, residual: &[f64]) -> Vec<NarrowBand> {
    let data = model.free_run.data;
    let vehicle = &model.free_run.vehicle;
    let fastest = fastest_pole_hz(vehicle);
    let channels = data.channels.iter().zip(data.ranges()).enumerate();
    let lines: Vec<NarrowBand> = channels
        .filter(|(_, (channel, _))| vehicle.outputs[channel.output].vibration.is_none())
        .filter(|(_, (channel, _))| {
            let place = &vehicle.outputs[channel.output].name;
            !model.terms.iter().any(|t| t.kind == Kind::Vibration && t.place == *place)
        })
        .flat_map(|(c, (channel, range))| {
            let period_s = data.period_s * channel.stride as f64;
            let found = lines(&residual[range], period_s, ABOVE_VEHICLE_RATIO * fastest);
            found.into_iter().map(move |line| NarrowBand { channel: c, ..line })
        })
        .collect();
    let shaken = lines.iter().filter(|line| lines.iter().any(|other| other.steady && same(line, other)));
    let mut found: Vec<NarrowBand> = shaken.copied().collect();
    // The strongest of each channel comes first.
    found.dedup_by_key(|line| line.channel);
    found
}

/// Magnitude of the vehicle's fastest pole, Hz; where the poles cannot be computed, a bound on it.
pub(crate) fn fastest_pole_hz(vehicle: &Vehicle) -> f64 {
    spectral_radius(&vehicle.a).unwrap_or_else(|_| vehicle.a.norm()) / std::f64::consts::TAU
}

/// The lines above `lowest_hz`, the strongest first.
fn lines(residual: &[f64], period_s: f64, lowest_hz: f64) -> Vec<NarrowBand> {
    let spectrum = welch(residual, period_s);
    let Some(&df) = spectrum.frequency_hz.get(1) else { return Vec::new() };
    let total: f64 = spectrum.density.iter().sum::<f64>() * df;
    // The window alone spreads a tone over four bins.
    if 4.0 * df > 2.0 * LINE_REACH / period_s {
        return Vec::new();
    }
    let around = |f: f64, from: f64, to: f64| -> Vec<(f64, f64)> {
        let reach = from / period_s..=to / period_s;
        let bins = spectrum.frequency_hz.iter().zip(&spectrum.density);
        bins.filter(|(g, _)| reach.contains(&(**g - f).abs())).map(|(g, d)| (*g, *d)).collect()
    };
    let line = |peak: Peak| {
        let surroundings: Vec<f64> = around(peak.frequency_hz, SURROUNDINGS_REACH, 3.0 * SURROUNDINGS_REACH)
            .into_iter()
            .map(|(_, d)| d)
            .collect();
        if peak.frequency_hz < lowest_hz || surroundings.len() < 8 {
            return None;
        }
        let floor = median(&surroundings);
        let above = |d: f64| (d - floor).max(0.0);
        // The line of a varying frequency is asymmetric: its centre is not at its peak.
        let f = {
            let near = around(peak.frequency_hz, 0.0, 2.0 * LINE_REACH);
            let weight: f64 = near.iter().map(|(_, d)| above(*d)).sum();
            near.iter().map(|(g, d)| g * above(*d)).sum::<f64>() / weight
        };
        let line = around(f, 0.0, LINE_REACH);
        let power = line.iter().map(|(_, d)| above(*d)).sum::<f64>() * df;
        let height = line.iter().fold(0.0f64, |m, (_, d)| m.max(*d));
        let share = power / total;
        if height < LINE_HEIGHT * floor || share < LINE_RESIDUAL_SHARE {
            return None;
        }
        // Number of independent averages per bin: bins of the whole record's spectrum within its width.
        let averages = residual.len() as f64 * period_s * df;
        let gain = line.iter().map(|(_, d)| 2.0 * averages * (d / floor - 1.0 - (d / floor).ln()).max(0.0));
        let spread = line.iter().map(|(g, d)| (g - f).powi(2) * above(*d)).sum::<f64>() * df / power;
        let spread = spread.sqrt().max(0.5 * df);
        let looks = (residual.len() as f64 * period_s * spread).max(1.0);
        let amplitude = (2.0 * power).sqrt();
        Some(NarrowBand {
            channel: 0,
            frequency_hz: (f, 1.96 * spread / looks.sqrt()),
            amplitude: (amplitude, 1.96 * 0.5 * amplitude / looks.sqrt()),
            wander_hz: spread,
            floor,
            share,
            gain: gain.sum(),
            steady: is_steady(residual, f * period_s),
        })
    };
    peaks(&spectrum, LINES_EXAMINED).into_iter().filter_map(line).collect()
}

/// True when the envelope at a frequency (cycles per sample) is steadier than that of noise. The power of
/// Gaussian noise in a narrow band is exponentially distributed: the mean of its square is twice the square
/// of its mean (Rice 1944), while for a sine they are equal. Powers that are one over the bandwidth apart are
/// independent, and the ratio of N of them scatters about 2 with a variance of 4 / N.
fn is_steady(residual: &[f64], frequency: f64) -> bool {
    let n = residual.len();
    let mut buffer: Vec<C64> = residual.iter().map(|v| C64::new(*v, 0.0)).collect();
    fft::forward(n).process(&mut buffer);
    let reach = 2.0 * LINE_REACH;
    for (k, b) in buffer.iter_mut().enumerate() {
        if (k as f64 / n as f64 - frequency).abs() > reach {
            *b = C64::new(0.0, 0.0);
        }
    }
    fft::inverse(n).process(&mut buffer);
    let power: Vec<f64> = buffer.iter().map(|b| b.norm_sqr()).collect();
    let (first, second) = (mean(&power), mean(&power.iter().map(|p| p * p).collect::<Vec<_>>()));
    let independent = 2.0 * reach * n as f64;
    second < (2.0 - STEADY_SIGMAS * (4.0 / independent).sqrt()) * first * first
}

/// Declares the line as a vibration of the vehicle's output, since its phase cannot be reproduced.
pub fn declare(vehicle: &mut Vehicle, data: &Data, found: &NarrowBand) {
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

/// True for two lines of one narrow-band noise.
pub fn same(a: &NarrowBand, b: &NarrowBand) -> bool {
    (a.frequency_hz.0 - b.frequency_hz.0).abs() < SAME_LINE_SHARE * a.frequency_hz.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    const PERIOD_S: f64 = 0.01;

    /// White noise behind a resonance of this radius at 27.6 Hz, of unit variance, in white noise of 0.1.
    fn resonant(seed: u64, radius: f64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "narrow_band");
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
        let size = whirlstand_logs::stats::rms(&raw);
        raw.iter().map(|v| v / size + 0.1 * stream.normal()).collect()
    }

    /// A sine of amplitude sqrt(2) whose frequency walks about 27.6 Hz, in white noise of 0.1.
    fn rotor(seed: u64) -> Vec<f64> {
        let mut stream = Stream::new(seed, "rotor");
        let (mut offset_hz, mut phase) = (0.0, 0.0);
        let sample = |_| {
            offset_hz += -0.02 * offset_hz + 0.03 * stream.normal();
            phase += std::f64::consts::TAU * (27.6 + offset_hz) * PERIOD_S;
            2f64.sqrt() * f64::sin(phase) + 0.1 * stream.normal()
        };
        (0..8000).map(sample).collect()
    }

    #[test]
    fn a_rotor_that_wanders_is_found_with_its_size() {
        for seed in 0..20 {
            let found = lines(&rotor(seed), PERIOD_S, 5.0)[0];
            let (f, half) = found.frequency_hz;
            assert!((f - 27.6).abs() < 0.3 && half < 0.3, "{found:?}");
            assert!((found.amplitude.0 - 2f64.sqrt()).abs() < 0.35, "{found:?}");
            assert!(found.steady && found.share > 0.7 && found.gain > 100.0, "{found:?}");
        }
    }

    #[test]
    fn resonant_noise_is_no_rotor_however_narrow_and_slow_lines_are_none() {
        let steady = |radius: f64| {
            (0..200).filter(|s| lines(&resonant(*s, radius), PERIOD_S, 5.0).iter().any(|l| l.steady)).count()
        };
        for radius in [0.95, 0.97, 0.99, 0.993] {
            assert!(steady(radius) <= 4, "{radius}: {} of 200", steady(radius));
        }
        assert_eq!(lines(&rotor(1), PERIOD_S, 30.0), []);
    }
}
