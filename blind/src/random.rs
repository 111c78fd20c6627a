//! Random numbers of the blind trials, with a separate stream for every purpose.

use std::f64::consts::TAU;

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// The random number stream of one purpose.
#[derive(Debug, Clone)]
pub(crate) struct RandomStream {
    rng: ChaCha12Rng,
    /// Second value of the last pair of normal numbers, not yet used.
    spare: Option<f64>,
}

impl RandomStream {
    /// The stream of `purpose` in trial `trial`.
    pub fn new(trial: u64, purpose: &str) -> Self {
        let mut key = [0u8; 32];
        key[..8].copy_from_slice(&trial.to_le_bytes());
        // The bytes of the purpose are folded into the rest of the key.
        for (i, byte) in purpose.bytes().enumerate() {
            let at = 8 + i % 24;
            key[at] = key[at].rotate_left(3) ^ byte;
        }
        Self { rng: ChaCha12Rng::from_seed(key), spare: None }
    }

    /// Uniform on (0, 1).
    pub fn unit(&mut self) -> f64 {
        ((self.rng.next_u64() >> 12) as f64 + 0.5) / (1u64 << 52) as f64
    }

    /// Uniform between `low` and `high`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in an interval.
    pub fn within(&mut self, (low, high): (f64, f64)) -> f64 {
        self.between(low, high)
    }

    /// Log-uniform in an interval above 0.
    pub fn scaled_within(&mut self, (low, high): (f64, f64)) -> f64 {
        self.scaled(low, high)
    }

    /// Log-uniform between `low` and `high`, both above 0.
    pub fn scaled(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    /// A random integer from 0 to `count - 1`; `count` must be above 0.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count - 1)
    }

    /// A random element of the slice; `None` where it is empty.
    pub fn one_of<'a, T>(&mut self, from: &'a [T]) -> Option<&'a T> {
        if from.is_empty() { None } else { Some(&from[self.below(from.len())]) }
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// 1 or -1 with equal probability.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// A standard normal number (Box-Muller method).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        let radius = (-2.0 * libm::log(self.unit())).sqrt();
        let (sine, cosine) = libm::sincos(TAU * self.unit());
        self.spare = Some(radius * sine);
        radius * cosine
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_trial_and_purpose_and_repeat() {
        let first = |trial, purpose| RandomStream::new(trial, purpose).unit();
        assert_eq!(first(1, "noise"), first(1, "noise"));
        assert_ne!(first(1, "noise"), first(2, "noise"));
        assert_ne!(first(1, "noise"), first(1, "effect"));
    }

    #[test]
    fn normal_numbers_have_unit_variance_and_no_mean() {
        let mut stream = RandomStream::new(7, "normal");
        let n = 100_000;
        let values: Vec<f64> = (0..n).map(|_| stream.normal()).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        let fourth = values.iter().map(|v| v.powi(4)).sum::<f64>() / f64::from(n);
        // The limits are five standard errors.
        assert!(mean.abs() < 0.016 && (variance - 1.0).abs() < 0.023 && (fourth - 3.0).abs() < 0.16);
    }
}
