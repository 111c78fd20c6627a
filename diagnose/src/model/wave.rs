//! Sine and cosine at even steps, by complex rotation.

use std::f64::consts::TAU;

/// Rotations after which the angle is recomputed, so that rounding does not accumulate.
const ROTATIONS: u32 = 64;

/// Generator of sine and cosine of a phase that grows by a constant angle per value.
#[derive(Debug, Clone)]
pub(crate) struct Wave {
    /// Phase of the first value and phase increment, in turns.
    first: f64,
    each: f64,
    /// Number of values generated.
    given: u32,
    rotation: (f64, f64),
    now: (f64, f64),
}

impl Wave {
    /// A wave of phases `first`, `first + each` and so on, in turns.
    pub fn new(first: f64, each: f64) -> Self {
        Self { first, each, given: 0, rotation: (TAU * each).sin_cos(), now: (0.0, 1.0) }
    }

    /// Restarts at another phase, in turns.
    pub fn begin(&mut self, first: f64) {
        (self.first, self.given) = (first, 0);
    }

    /// The next sine and cosine.
    #[inline]
    pub fn advance(&mut self) -> (f64, f64) {
        if self.given.is_multiple_of(ROTATIONS) {
            let turns = self.first + self.each * f64::from(self.given);
            self.now = (TAU * (turns - turns.floor())).sin_cos();
        } else {
            let ((s, c), (by_s, by_c)) = (self.now, self.rotation);
            self.now = (s * by_c + c * by_s, c * by_c - s * by_s);
        }
        self.given += 1;
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_stay_on_the_sine() {
        let mut wave = Wave::new(0.3, 0.0137);
        for k in 0..100_000 {
            let (s, c) = (TAU * (0.3 + 0.0137 * f64::from(k))).sin_cos();
            let (own_s, own_c) = wave.advance();
            assert!((s - own_s).abs() < 1e-11 && (c - own_c).abs() < 1e-11, "{k}: {own_s} {s}");
        }
    }
}
