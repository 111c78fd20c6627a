//! Sensor noise of known colour, and the filter that makes it white again.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::random::Dice;

/// Colour of the sensor noise of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Colour {
    /// White.
    White,
    /// First-order autoregressive with coefficient 0.9.
    Ar1,
    /// Second-order autoregressive with a peak.
    Resonant {
        /// Frequency of the peak, Hz.
        frequency_hz: f64,
        /// Radius of the poles.
        radius: f64,
    },
}

impl Colour {
    /// Name, for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::Ar1 => "AR(1) 0.9",
            Self::Resonant { .. } => "resonant",
        }
    }

    /// x_k = phi1 x_{k-1} + phi2 x_{k-2} + e_k.
    fn coefficients(self, period_s: f64) -> (f64, f64) {
        match self {
            Self::White => (0.0, 0.0),
            Self::Ar1 => (0.9, 0.0),
            Self::Resonant { frequency_hz, radius } => {
                (2.0 * radius * (TAU * frequency_hz * period_s).cos(), -radius * radius)
            }
        }
    }

    /// Standard deviation of e for noise of standard deviation 1 (Yule and Walker).
    fn innovation(self, period_s: f64) -> f64 {
        let (phi1, phi2) = self.coefficients(period_s);
        let gain = (1.0 - phi2) / ((1.0 + phi2) * ((1.0 - phi2).powi(2) - phi1 * phi1));
        gain.recip().sqrt()
    }

    /// Stationary noise of standard deviation 1.
    pub(crate) fn noise(self, samples: usize, period_s: f64, dice: &mut Dice) -> Vec<f64> {
        let (phi1, phi2) = self.coefficients(period_s);
        let innovation = self.innovation(period_s);
        // The memory of the poles is below 1e-6 after this many steps.
        let warm_up = if self == Self::White { 0 } else { 400 };
        let (mut one, mut two) = (0.0, 0.0);
        let mut next = || {
            let x = phi1 * one + phi2 * two + innovation * dice.normal();
            (two, one) = (one, x);
            x
        };
        (0..warm_up).for_each(|_| {
            next();
        });
        (0..samples).map(|_| next()).collect()
    }

    /// Makes noise of standard deviation `std` white with variance 1, in place. `signal` is one of `columns` that
    /// alternate in it, the `column`th.
    pub(crate) fn whiten(self, signal: &mut [f64], column: usize, columns: usize, std: f64, period_s: f64) {
        let (phi1, phi2) = self.coefficients(period_s);
        let scale = 1.0 / (std * self.innovation(period_s));
        let rho = phi1 / (1.0 - phi2);
        let (mut one, mut two) = (0.0, 0.0);
        for (k, x) in signal.iter_mut().skip(column).step_by(columns).enumerate() {
            let now = *x;
            *x = match k {
                0 => now / std,
                // Given the first alone, the second has a larger spread than later ones given two.
                1 if phi2 != 0.0 => (now - rho * one) / (std * (1.0 - rho * rho).sqrt()),
                _ => scale * (now - phi1 * one - phi2 * two),
            };
            (two, one) = (one, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_its_size_and_the_filter_makes_it_white() {
        for colour in [Colour::White, Colour::Ar1, Colour::Resonant { frequency_hz: 9.0, radius: 0.93 }] {
            let n = 200_000;
            let noise = colour.noise(n, 0.01, &mut Dice::new(1, "test"));
            let variance = noise.iter().map(|x| x * x).sum::<f64>() / n as f64;
            // Correlation over some 20 samples: five standard errors are 7 %.
            assert!((variance - 1.0).abs() < 0.07, "{colour:?} {variance}");
            let mut white: Vec<f64> = noise.iter().map(|x| 3.0 * x).collect();
            colour.whiten(&mut white, 0, 1, 3.0, 0.01);
            for lag in 0..6 {
                let r = white.iter().zip(&white[lag..]).map(|(a, b)| a * b).sum::<f64>() / n as f64;
                let expected = if lag == 0 { 1.0 } else { 0.0 };
                assert!((r - expected).abs() < 0.016, "{colour:?} lag {lag}: {r}");
            }
        }
    }
}
