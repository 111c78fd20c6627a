//! Turbulence: a stationary random force of known spectrum, piecewise constant over 1 ms.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::random::RandomStream;
use super::signal::Signal;

/// Spectrum of turbulence of a given standard deviation and bandwidth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Spectrum {
    /// First-order low-pass filtered white noise: the definition of the table.
    #[default]
    FirstOrder,
    /// The Dryden spectrum across the flight path: white noise filtered by (1 + sqrt(3) T s) / (1 + T s)^2
    /// (MIL-HDBK-1797).
    Dryden,
}

/// Interval over which the force is constant, s.
const FINE_S: f64 = 1e-3;

/// Draws the force on a state until `end_s`; the time constant T is 1 / (2 pi bandwidth).
pub(crate) fn turbulence(
    spectrum: Spectrum,
    std: f64,
    bandwidth_hz: f64,
    end_s: f64,
    stream: &mut RandomStream,
) -> Signal {
    let decay = (-TAU * bandwidth_hz * FINE_S).exp();
    let count = (end_s / FINE_S).ceil() as usize;
    match spectrum {
        Spectrum::FirstOrder => first_order(std, decay, count, stream),
        Spectrum::Dryden => dryden(std, decay, count, stream),
    }
}

fn first_order(std: f64, decay: f64, count: usize, stream: &mut RandomStream) -> Signal {
    let kick = std * (1.0 - decay * decay).sqrt();
    let mut value = std * stream.normal();
    let values = std::iter::repeat_with(|| {
        let now = value;
        value = decay * value + kick * stream.normal();
        now
    });
    Signal::held(values.take(count), FINE_S, 0.0)
}

/// Partial fractions of the Dryden filter: sqrt(3) times one lag and 1 - sqrt(3) times two lags in series.
fn dryden(std: f64, decay: f64, count: usize, stream: &mut RandomStream) -> Signal {
    let (single, double) = (3f64.sqrt(), 1.0 - 3f64.sqrt());
    // Stationary covariance of both lags for unit variance of the first, from the discrete Lyapunov equation.
    let cross = decay / (1.0 + decay);
    let second_variance = (1.0 - decay + 2.0 * decay * cross) / (1.0 + decay);
    let variance = single * single + 2.0 * single * double * cross + double * double * second_variance;
    let gain = std / variance.sqrt();
    let kick = (1.0 - decay * decay).sqrt();
    let mut first = stream.normal();
    let mut second = cross * first + (second_variance - cross * cross).sqrt() * stream.normal();
    let values = std::iter::repeat_with(|| {
        let now = gain * (single * first + double * second);
        second = decay * second + (1.0 - decay) * first;
        first = decay * first + kick * stream.normal();
        now
    });
    Signal::held(values.take(count), FINE_S, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_spectra_have_their_size_and_dryden_its_correlation() {
        let (std, bandwidth_hz) = (0.7, 1.0);
        for spectrum in [Spectrum::FirstOrder, Spectrum::Dryden] {
            let mut stream = RandomStream::new(3, "turbulence");
            let force = turbulence(spectrum, std, bandwidth_hz, 2000.0, &mut stream);
            let values: Vec<f64> = force.pieces().iter().map(|p| p.value).collect();
            let covariance = |lag: usize| {
                values.iter().zip(&values[lag..]).map(|(a, b)| a * b).sum::<f64>() / values.len() as f64
            };
            // There are some 6000 correlation times: five standard errors are below 10 %.
            assert!((covariance(0) / (std * std) - 1.0).abs() < 0.1, "{spectrum:?} {}", covariance(0));
            // The correlation of the Dryden spectrum is exp(-r) (1 - r / 2) with r in time constants, so it
            // is 0 at r = 2.
            let correlation = covariance(318) / covariance(0);
            let expected = if spectrum == Spectrum::Dryden { 0.0 } else { (-2.0f64).exp() };
            assert!((correlation - expected).abs() < 0.06, "{spectrum:?} {correlation}");
        }
    }
}
