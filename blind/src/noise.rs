//! Sensor noise with a given spectrum, and its whitening filter.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::autoregression::Autoregression;
use super::random::RandomStream;

/// Spectrum and distribution of the sensor noise of a trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Colour {
    /// White noise.
    White,
    /// First-order autoregressive noise.
    Ar1 {
        /// Coefficient; 0.9 where results of older runs give none.
        #[serde(default = "usual_coefficient")]
        coefficient: f64,
    },
    /// Second-order autoregressive noise with a spectral peak.
    Resonant {
        /// Frequency of the peak, Hz.
        frequency_hz: f64,
        /// Radius of the poles.
        radius: f64,
    },
    /// Fourth-order autoregressive noise with two spectral peaks.
    Ar4 {
        /// Frequencies of the peaks, Hz.
        frequencies_hz: [f64; 2],
        /// Radii of their poles.
        radii: [f64; 2],
    },
    /// White noise plus a drifting zero: a first-order autoregressive process with a time constant of
    /// seconds.
    Wandering {
        /// Time constant of the drifting zero, s.
        time_constant_s: f64,
        /// Share of the variance that is white noise.
        white_share: f64,
    },
    /// White noise with Student's t distribution, which has heavier tails than the normal distribution.
    StudentT {
        /// Degrees of freedom, above 2.
        degrees: u32,
    },
}

/// The coefficient of AR(1) noise in the reference generator.
const USUAL_COEFFICIENT: f64 = 0.9;

fn usual_coefficient() -> f64 {
    USUAL_COEFFICIENT
}

impl Colour {
    /// Names of the reference generator's colours.
    pub(crate) const REFERENCE: [&'static str; 3] = ["white", "AR(1) 0.9", "resonant"];

    /// Name of the noise, for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::Ar1 { coefficient } if coefficient == USUAL_COEFFICIENT => "AR(1) 0.9",
            Self::Ar1 { .. } => "AR(1)",
            Self::Resonant { .. } => "resonant",
            Self::Ar4 { .. } => "AR(4)",
            Self::Wandering { .. } => "wandering",
            Self::StudentT { .. } => "Student t",
        }
    }

    /// Draws stationary noise of standard deviation 1.
    pub(crate) fn noise(self, samples: usize, period_s: f64, stream: &mut RandomStream) -> Vec<f64> {
        match self {
            Self::White | Self::Ar1 { .. } | Self::Resonant { .. } => {
                self.recursion(samples, period_s, stream)
            }
            Self::Ar4 { frequencies_hz, radii } => {
                Autoregression::of_poles(frequencies_hz.map(|hz| hz * period_s), radii).noise(samples, stream)
            }
            Self::Wandering { time_constant_s, white_share } => {
                let decay = (-period_s / time_constant_s).exp();
                let mut zero = stream.normal();
                let mut next = || {
                    let now = (1.0 - white_share).sqrt() * zero + white_share.sqrt() * stream.normal();
                    zero = decay * zero + (1.0 - decay * decay).sqrt() * stream.normal();
                    now
                };
                (0..samples).map(|_| next()).collect()
            }
            Self::StudentT { degrees } => (0..samples).map(|_| student_t(degrees, stream)).collect(),
        }
    }

    /// Whitens noise of standard deviation `std` to variance 1, in place. `signal` interleaves `columns`
    /// channels; only channel `column` is whitened.
    pub(crate) fn whiten(self, signal: &mut [f64], column: usize, columns: usize, std: f64, period_s: f64) {
        match self {
            Self::White | Self::Ar1 { .. } | Self::Resonant { .. } | Self::StudentT { .. } => {
                self.invert(signal, column, columns, std, period_s);
            }
            Self::Ar4 { frequencies_hz, radii } => {
                let process = Autoregression::of_poles(frequencies_hz.map(|hz| hz * period_s), radii);
                process.whiten(signal.iter_mut().skip(column).step_by(columns), std);
            }
            Self::Wandering { time_constant_s, white_share } => {
                let decay = (-period_s / time_constant_s).exp();
                // Kalman filter of the drifting zero, for noise of standard deviation 1.
                let (mut zero, mut variance) = (0.0, 1.0 - white_share);
                for x in signal.iter_mut().skip(column).step_by(columns) {
                    let (new, spread) = (*x / std - zero, variance + white_share);
                    let gain = variance / spread;
                    zero = decay * (zero + gain * new);
                    variance =
                        decay * decay * (1.0 - gain) * variance + (1.0 - decay * decay) * (1.0 - white_share);
                    *x = new / spread.sqrt();
                }
            }
        }
    }

    /// (phi1, phi2) of x_k = phi1 x_{k-1} + phi2 x_{k-2} + e_k.
    fn coefficients(self, period_s: f64) -> (f64, f64) {
        match self {
            Self::Ar1 { coefficient } => (coefficient, 0.0),
            Self::Resonant { frequency_hz, radius } => {
                (2.0 * radius * (TAU * frequency_hz * period_s).cos(), -radius * radius)
            }
            _ => (0.0, 0.0),
        }
    }

    /// Standard deviation of the innovation e for noise of standard deviation 1 (Yule-Walker equations).
    fn innovation(self, period_s: f64) -> f64 {
        let (phi1, phi2) = self.coefficients(period_s);
        let gain = (1.0 - phi2) / ((1.0 + phi2) * ((1.0 - phi2).powi(2) - phi1 * phi1));
        gain.recip().sqrt()
    }

    /// Draws noise of order 2 at most.
    fn recursion(self, samples: usize, period_s: f64, stream: &mut RandomStream) -> Vec<f64> {
        let (phi1, phi2) = self.coefficients(period_s);
        let innovation = self.innovation(period_s);
        // The transient of the poles has decayed below 1e-6 after this many steps.
        let warm_up = if self == Self::White { 0 } else { 400 };
        let (mut one, mut two) = (0.0, 0.0);
        let mut next = || {
            let x = phi1 * one + phi2 * two + innovation * stream.normal();
            (two, one) = (one, x);
            x
        };
        (0..warm_up).for_each(|_| {
            next();
        });
        (0..samples).map(|_| next()).collect()
    }

    /// Whitens noise: the inverse of [`Self::recursion`].
    fn invert(self, signal: &mut [f64], column: usize, columns: usize, std: f64, period_s: f64) {
        let (phi1, phi2) = self.coefficients(period_s);
        let scale = 1.0 / (std * self.innovation(period_s));
        let rho = phi1 / (1.0 - phi2);
        let (mut one, mut two) = (0.0, 0.0);
        for (k, x) in signal.iter_mut().skip(column).step_by(columns).enumerate() {
            let now = *x;
            *x = match k {
                0 => now / std,
                // Given only the first value, the second has a larger variance than later values, which are
                // given two.
                1 if phi2 != 0.0 => (now - rho * one) / (std * (1.0 - rho * rho).sqrt()),
                _ => scale * (now - phi1 * one - phi2 * two),
            };
            (two, one) = (one, now);
        }
    }
}

/// Draws a number of Student's t distribution, scaled to variance 1.
fn student_t(degrees: u32, stream: &mut RandomStream) -> f64 {
    let square: f64 = (0..degrees).map(|_| stream.normal().powi(2)).sum();
    let degrees = f64::from(degrees);
    stream.normal() / (square / degrees).sqrt() * ((degrees - 2.0) / degrees).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_its_size_and_the_filter_makes_it_white() {
        for colour in [
            Colour::White,
            Colour::Ar1 { coefficient: 0.9 },
            Colour::Ar1 { coefficient: -0.55 },
            Colour::Resonant { frequency_hz: 9.0, radius: 0.93 },
            Colour::Resonant { frequency_hz: 12.0, radius: 0.6 },
            Colour::Ar4 { frequencies_hz: [6.0, 31.0], radii: [0.92, 0.8] },
            Colour::Wandering { time_constant_s: 0.3, white_share: 0.4 },
            Colour::StudentT { degrees: 6 },
        ] {
            let n = 200_000;
            let noise = colour.noise(n, 0.01, &mut RandomStream::new(1, "test"));
            let variance = noise.iter().map(|x| x * x).sum::<f64>() / n as f64;
            // The noise is correlated over some 20 samples: 7 % are five standard errors.
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
