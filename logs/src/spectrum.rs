//! Power spectral density by Welch's method, and its spectral lines.

use serde::{Deserialize, Serialize};
use whirlstand_linalg::{C64, fft};

use crate::stats::{mean, median};

/// One-sided power spectral density.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Spectrum {
    /// Frequencies, Hz, from 0 to half the sampling rate.
    pub frequency_hz: Vec<f64>,
    /// Density, signal unit squared per Hz.
    pub density: Vec<f64>,
    /// Number of segments averaged.
    pub segments: usize,
}

/// A line in a [`Spectrum`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Peak {
    /// Frequency, Hz, between the bins (interpolated).
    pub frequency_hz: f64,
    /// Amplitude of the sine that has the power of the line above the floor, in the unit of the signal.
    pub amplitude: f64,
    /// Power of the line divided by the power of the signal, 0 to 1.
    pub share: f64,
}

/// Welch's estimate with Hann windows that overlap by half (Welch 1967), the mean removed. The segment length is
/// a power of two, about an eighth of the record, so that some fifteen segments are averaged.
///
/// Empty when the signal has fewer than 16 samples.
pub fn welch(signal: &[f64], period_s: f64) -> Spectrum {
    if signal.len() < 16 {
        return Spectrum::default();
    }
    let mut length = 16;
    while length * 2 <= signal.len() / 8 && length < 8192 {
        length *= 2;
    }
    let offset = mean(signal);
    let window: Vec<f64> = (0..length)
        .map(|i| 0.5 - 0.5 * (2.0 * std::f64::consts::PI * i as f64 / length as f64).cos())
        .collect();
    let scale = period_s / window.iter().map(|w| w * w).sum::<f64>();
    let transform = fft::forward(length);
    let mut buffer = vec![C64::new(0.0, 0.0); length];
    let mut density = vec![0.0; length / 2 + 1];
    let mut segments = 0;
    for start in (0..=signal.len() - length).step_by(length / 2) {
        for ((b, w), y) in buffer.iter_mut().zip(&window).zip(&signal[start..]) {
            *b = C64::new(w * (y - offset), 0.0);
        }
        transform.process(&mut buffer);
        for (d, b) in density.iter_mut().zip(&buffer) {
            *d += b.norm_sqr();
        }
        segments += 1;
    }
    let last = density.len() - 1;
    for (i, d) in density.iter_mut().enumerate() {
        let sides = if i == 0 || i == last { 1.0 } else { 2.0 };
        *d *= sides * scale / segments as f64;
    }
    let frequency_hz = (0..density.len()).map(|i| i as f64 / (length as f64 * period_s)).collect();
    Spectrum { frequency_hz, density, segments }
}

/// Relative frequency variation of a rotor: maxima closer than that to a stronger one belong to it.
const WANDER: f64 = 0.05;

/// The lines of a spectrum, strongest first, at most `most`.
///
/// A line is a local maximum that stands above the median of its surroundings (an octave-wide part, at least 15
/// bins) by more than chance lets any bin of white noise stand: with `K` averaged segments, a bin scatters with
/// about `9/11 K` independent averages (half-overlapping Hann windows), and `exp`-tailed maxima over all bins
/// stay below `1 + (ln n + sqrt(2 k ln n)) / k` times the level (Laurent and Massart 2000, lemma 1), twice
/// that for the unknown shape of the floor.
pub fn peaks(spectrum: &Spectrum, most: usize) -> Vec<Peak> {
    let d = &spectrum.density;
    if d.len() < 9 || spectrum.segments == 0 {
        return Vec::new();
    }
    let df = spectrum.frequency_hz[1];
    let total: f64 = d.iter().sum::<f64>() * df;
    let k = (9.0 / 11.0 * spectrum.segments as f64).max(1.0);
    let ln_n = (d.len() as f64).ln() + 3.0;
    let threshold = 2.0 * (1.0 + (ln_n + (2.0 * k * ln_n).sqrt()) / k);
    let mut found = Vec::new();
    for i in 2..d.len() - 2 {
        if d[i] < d[i - 1] || d[i] <= d[i + 1] {
            continue;
        }
        let reach = (i / 3).max(7);
        let around: Vec<f64> = (i.saturating_sub(reach).max(1)..(i + reach + 1).min(d.len()))
            .filter(|&j| j.abs_diff(i) > 2)
            .map(|j| d[j])
            .collect();
        let floor = median(&around);
        if d[i] <= threshold * floor {
            continue;
        }
        // The main lobe of the Hann window is four bins wide.
        let power: f64 = (i - 2..=i + 2).map(|j| (d[j] - floor).max(0.0)).sum::<f64>() * df;
        // Exact for a sine between two bins under the Hann window, from the amplitude ratio of neighbouring
        // bins.
        let (left, middle, right) = (d[i - 1].sqrt(), d[i].sqrt(), d[i + 1].sqrt());
        let shift = if right >= left {
            let ratio = right / middle;
            (2.0 * ratio - 1.0) / (ratio + 1.0)
        } else {
            let ratio = left / middle;
            -(2.0 * ratio - 1.0) / (ratio + 1.0)
        };
        found.push(Peak {
            frequency_hz: (i as f64 + shift.clamp(-0.5, 0.5)) * df,
            amplitude: (2.0 * power).sqrt(),
            share: if total > 0.0 { (power / total).min(1.0) } else { 0.0 },
        });
    }
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    let mut lines: Vec<Peak> = Vec::new();
    for peak in found {
        let of = |line: &Peak| {
            (peak.frequency_hz - line.frequency_hz).abs() < (WANDER * line.frequency_hz).max(4.0 * df)
        };
        if lines.len() < most && !lines.iter().any(of) {
            lines.push(peak);
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    fn tone(n: usize, dt: f64, f: f64, a: f64, noise_std: f64, seed: u64) -> Vec<f64> {
        let e = noise(n, seed);
        (0..n)
            .map(|i| a * (2.0 * std::f64::consts::PI * f * i as f64 * dt + 0.3).sin() + noise_std * e[i])
            .collect()
    }

    #[test]
    fn the_density_integrates_to_the_variance() {
        let e = noise(20_000, 5);
        let s = welch(&e, 0.01);
        let power = s.density.iter().sum::<f64>() * s.frequency_hz[1];
        assert!((power - 1.0).abs() < 0.05, "{power}");
        // White noise of unit variance at 100 Hz has 0.02 per Hz everywhere.
        assert!((median(&s.density) - 0.02).abs() < 0.003, "{}", median(&s.density));
    }

    #[test]
    fn a_tone_is_found_with_its_frequency_and_amplitude() {
        for (f, a) in [(27.6, 0.5), (3.217, 0.2), (11.0, 1.5)] {
            let s = welch(&tone(8_000, 0.01, f, a, 0.1, 9), 0.01);
            let p = peaks(&s, 5);
            assert_eq!(p.len(), 1, "{p:?}");
            assert!((p[0].frequency_hz - f).abs() < 0.01, "{f}: {p:?}");
            assert!((p[0].amplitude / a - 1.0).abs() < 0.05, "{a}: {p:?}");
            let share = 0.5 * a * a / (0.5 * a * a + 0.01);
            assert!((p[0].share - share).abs() < 0.05, "{share}: {p:?}");
        }
    }

    #[test]
    fn noise_alone_has_no_line() {
        for seed in 0..100 {
            let found = peaks(&welch(&noise(6_000, seed), 0.01), 5);
            assert!(found.is_empty(), "seed {seed}: {found:?}");
        }
    }

    #[test]
    fn too_short_is_empty() {
        assert!(welch(&[1.0; 15], 0.1).density.is_empty());
        assert!(peaks(&Spectrum::default(), 3).is_empty());
    }

    #[test]
    fn a_rotor_whose_speed_wanders_is_one_line() {
        let e = noise(8_000, 21);
        let mut phase = 0.0;
        let y: Vec<f64> = (0..8_000)
            .map(|i| {
                let f = 27.6 + 0.5 * (i as f64 * 0.004).sin();
                phase += std::f64::consts::TAU * f * 0.01;
                phase.sin() + 0.05 * e[i]
            })
            .collect();
        let found = peaks(&welch(&y, 0.01), 5);
        assert!(found.len() == 1 && (found[0].frequency_hz - 27.6).abs() < 0.8, "{found:?}");
    }
}
