//! Test inputs for flight identification, with amplitude one.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Stream;

/// Kind of test input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// One step to each side, one input after the other.
    Doublets,
    /// Steps of 3, 2, 1 and 1 units to alternating sides, one input after the other.
    #[serde(rename = "3-2-1-1")]
    Steps3211,
    /// Steps of random length and size on all inputs at once, as a pilot flies them.
    Multistep,
    /// Sums of sines on all inputs at once; no two inputs share a frequency, phases flatten the peaks.
    Multisine,
    /// Sines of rising frequency, one input after the other.
    Sweep,
}

/// Kind, length and frequencies of a test input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Kind of test input.
    pub kind: Kind,
    /// Number of steps.
    pub steps: usize,
    /// Time between two steps, s.
    pub period_s: f64,
    /// Lowest frequency, Hz.
    pub lowest_hz: f64,
    /// Highest frequency, Hz.
    pub highest_hz: f64,
    /// Seed of the random kinds.
    pub seed: u64,
}

impl Shape {
    /// Length of the flight, s.
    pub fn duration_s(&self) -> f64 {
        self.steps as f64 * self.period_s
    }
}

/// Signals of `m` inputs, one vector each, within -1 to 1. The first and the last second are zero. Where the
/// vehicle integrates an input `integrations` times, that integral returns to zero after every random step.
pub fn signals(shape: &Shape, m: usize, integrations: usize) -> Vec<Vec<f64>> {
    let quiet = ((1.0 / shape.period_s) as usize).min(shape.steps / 10);
    let active = shape.steps - 2 * quiet;
    let mut all = match shape.kind {
        Kind::Multisine => multisine(shape, active, m),
        Kind::Multistep => (0..m).map(|j| multistep(shape, active, j, returning(integrations))).collect(),
        Kind::Doublets => one_by_one(shape, active, m, &[1.0, -1.0]),
        Kind::Steps3211 => one_by_one(shape, active, m, &[1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]),
        Kind::Sweep => sweep(shape, active, m),
    };
    for signal in &mut all {
        signal.resize(active, 0.0);
        signal.splice(0..0, std::iter::repeat_n(0.0, quiet));
        signal.resize(shape.steps, 0.0);
    }
    all
}

/// A repeated pattern of equal steps: each input in turn, with both signs, at three step lengths between the
/// lowest and the highest frequency, followed by a rest of one pattern.
fn one_by_one(shape: &Shape, active: usize, m: usize, pattern: &[f64]) -> Vec<Vec<f64>> {
    let mut all = vec![vec![0.0; active]; m];
    let ratio = shape.highest_hz / shape.lowest_hz;
    let (mut k, mut turn) = (0, 0usize);
    loop {
        // A doublet's power peaks near 2.3 rad over the length of its step (Jategaonkar 2015, section 2.4).
        let frequency = shape.lowest_hz * ratio.powf(0.25 + 0.25 * (turn / (2 * m) % 3) as f64);
        // Every input is excited, however short the flight.
        let longest = active / (2 * pattern.len() * m);
        let unit = ((2.3 / (TAU * frequency) / shape.period_s).round() as usize).min(longest).max(1);
        let (input, side) = (turn % m, if (turn / m).is_multiple_of(2) { 1.0 } else { -1.0 });
        if k + unit * pattern.len() > active {
            return all;
        }
        for value in pattern {
            all[input][k..k + unit].fill(side * value);
            k += unit;
        }
        k += unit * pattern.len();
        turn += 1;
    }
}

/// Signs of equal steps after which a single or double integral returns to its initial value (Thue-Morse
/// sequence).
fn returning(integrations: usize) -> &'static [f64] {
    match integrations {
        0 => &[1.0],
        1 => &[1.0, -1.0],
        _ => &[1.0, -1.0, -1.0, 1.0],
    }
}

fn multistep(shape: &Shape, active: usize, input: usize, signs: &[f64]) -> Vec<f64> {
    let mut stream = Stream::new(shape.seed, &format!("multistep {input}"));
    let mut signal = Vec::with_capacity(active);
    while signal.len() < active {
        // Half periods between those of the lowest and of the highest frequency, uniformly on a logarithmic
        // scale.
        let frequency = shape.lowest_hz * (shape.highest_hz / shape.lowest_hz).powf(stream.uniform());
        let length = ((0.5 / frequency / shape.period_s) as usize).max(1);
        let value = if stream.chance(0.2) { 0.0 } else { 2.0 * stream.uniform() - 1.0 };
        // A step without enough time to return is left out.
        if signs.len() > 1 && signal.len() + signs.len() * length > active {
            signal.resize(active, 0.0);
        }
        signal.extend(signs.iter().flat_map(|sign| std::iter::repeat_n(sign * value, length)));
    }
    signal.truncate(active);
    signal
}

fn sweep(shape: &Shape, active: usize, m: usize) -> Vec<Vec<f64>> {
    let each = active / m.max(1);
    let duration = each as f64 * shape.period_s;
    let rate = (shape.highest_hz / shape.lowest_hz).ln() / duration;
    (0..m)
        .map(|j| {
            let mut signal = vec![0.0; j * each];
            signal.extend((0..each).map(|k| {
                let t = k as f64 * shape.period_s;
                let fade = (t.min(duration - t) / (0.05 * duration)).min(1.0);
                fade * (TAU * shape.lowest_hz * ((rate * t).exp() - 1.0) / rate).sin()
            }));
            signal
        })
        .collect()
}

/// Each input gets every m-th harmonic of one over the duration, so that inputs are orthogonal over the record
/// (Morelli, AIAA 2012-4617). Phases start as Schroeder's (IEEE Trans. IT 16, 1970) and are improved by clipping (van
/// der Ouderaa, Schoukens and Renneboog, IEEE Trans. IM 37, 1988).
fn multisine(shape: &Shape, active: usize, m: usize) -> Vec<Vec<f64>> {
    let duration = active as f64 * shape.period_s;
    let first = (shape.lowest_hz * duration).ceil().max(1.0) as usize;
    let last = (shape.highest_hz * duration).floor() as usize;
    (0..m)
        .map(|j| {
            let harmonics: Vec<usize> = (first..=last).filter(|h| h % m == j).collect();
            let count = harmonics.len().max(1) as f64;
            let mut phases: Vec<f64> =
                (0..harmonics.len()).map(|i| -std::f64::consts::PI * (i * i) as f64 / count).collect();
            // The signal is sampled finely enough to resolve its peaks.
            let points = (last * 8).max(64);
            let tables: Vec<(Vec<f64>, Vec<f64>)> = harmonics
                .iter()
                .map(|h| {
                    (0..points).map(|k| (TAU * (h * k % points) as f64 / points as f64).sin_cos()).unzip()
                })
                .collect();
            let sum = |phases: &[f64]| -> Vec<f64> {
                let mut signal = vec![0.0; points];
                for ((sines, cosines), phase) in tables.iter().zip(phases) {
                    let (s, c) = phase.sin_cos();
                    signal
                        .iter_mut()
                        .zip(sines.iter().zip(cosines))
                        .for_each(|(v, (a, b))| *v += a * c + b * s);
                }
                signal
            };
            let peak = |signal: &[f64]| signal.iter().fold(0.0f64, |p, v| p.max(v.abs()));
            let mut best = (f64::INFINITY, phases.clone());
            for _ in 0..60 {
                let signal = sum(&phases);
                let top = peak(&signal);
                if top < best.0 {
                    best = (top, phases.clone());
                }
                let limit = 0.85 * top;
                let clipped: Vec<f64> = signal.iter().map(|v| v.clamp(-limit, limit)).collect();
                for ((sines, cosines), phase) in tables.iter().zip(&mut phases) {
                    let dot = |t: &[f64]| t.iter().zip(&clipped).map(|(a, b)| a * b).sum::<f64>();
                    *phase = dot(cosines).atan2(dot(sines));
                }
            }
            (0..active)
                .map(|k| {
                    let t = k as f64 * shape.period_s / duration;
                    let terms = harmonics.iter().zip(&best.1);
                    terms.map(|(h, phase)| (TAU * *h as f64 * t + phase).sin()).sum::<f64>()
                        / best.0.max(1e-9)
                })
                .map(|v: f64| v.clamp(-1.0, 1.0))
                .collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(kind: Kind) -> Shape {
        Shape { kind, steps: 6000, period_s: 0.01, lowest_hz: 0.1, highest_hz: 2.0, seed: 1 }
    }

    #[test]
    fn every_kind_moves_every_input_within_its_limits_and_ends_quietly() {
        for kind in [Kind::Doublets, Kind::Steps3211, Kind::Multistep, Kind::Multisine, Kind::Sweep] {
            let all = signals(&shape(kind), 3, 0);
            for signal in &all {
                assert_eq!(signal.len(), 6000);
                assert!(signal.iter().all(|v| v.abs() <= 1.0), "{kind:?}");
                let power: f64 = signal.iter().map(|v| v * v).sum();
                assert!(power > 10.0, "{kind:?} {power}");
                assert!(signal[..100].iter().chain(&signal[5900..]).all(|v| *v == 0.0), "{kind:?}");
            }
        }
    }

    #[test]
    fn integrals_come_back_after_every_step() {
        for integrations in [1, 2] {
            let signal = &signals(&shape(Kind::Multistep), 1, integrations)[0];
            let integral = |v: &[f64]| -> Vec<f64> {
                v.iter().scan(0.0, |sum, v| (*sum += v * 0.01, Some(*sum)).1).collect()
            };
            let mut of = signal.clone();
            for _ in 0..integrations {
                of = integral(&of);
                assert!(of[5999].abs() < 1e-9, "{integrations}: {}", of[5999]);
            }
            assert!(signal.iter().any(|v| *v != 0.0));
        }
    }

    #[test]
    fn multisines_are_orthogonal_and_flat() {
        let all = signals(&shape(Kind::Multisine), 2, 0);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let (a, b) = (&all[0], &all[1]);
        assert!(dot(a, b).abs() < 1e-3 * (dot(a, a) * dot(b, b)).sqrt());
        // Crest factor: sqrt(2) for one sine, far above 3 for random phases.
        let rms = (dot(a, a) / 5800.0).sqrt();
        assert!(1.0 / rms < 1.7, "{}", 1.0 / rms);
    }
}
