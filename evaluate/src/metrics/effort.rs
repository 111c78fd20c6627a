//! Control effort.

use serde::{Deserialize, Serialize};

use whirlstand_logs::stats::{mean, rms};

/// Effort of one input over a run, in the unit of the input.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Effort {
    /// Mean of the input: the trim that the controller holds.
    pub mean: f64,
    /// Root of the mean square of the input about neutral (zero).
    pub rms: f64,
    /// Greatest magnitude of the input.
    pub peak: f64,
    /// Sum of all changes over the length of the run: what the actuator travels a second (total variation,
    /// Skogestad and Postlethwaite 2005, section 2.4.1, per second).
    pub travel_per_s: f64,
    /// Share of the samples at a limit, 0 to 1.
    pub saturated: f64,
}

/// Effort of an input `u` sampled every `period_s` seconds with the given limits, all in one unit.
pub fn effort(u: &[f64], period_s: f64, lower: f64, upper: f64) -> Effort {
    let margin = if (upper - lower).is_finite() { 1e-9 * (upper - lower).abs() } else { 0.0 };
    let at_limit = u.iter().filter(|&&v| v <= lower + margin || v >= upper - margin).count();
    let variation: f64 = u.windows(2).map(|w| (w[1] - w[0]).abs()).sum();
    Effort {
        mean: mean(u),
        rms: rms(u),
        peak: u.iter().fold(0.0, |m, v| v.abs().max(m)),
        travel_per_s: if u.len() > 1 { variation / ((u.len() - 1) as f64 * period_s) } else { 0.0 },
        saturated: if u.is_empty() { 0.0 } else { at_limit as f64 / u.len() as f64 },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_saturated_square_wave() {
        let u: Vec<f64> = (0..1001).map(|i| if (i / 100) % 2 == 0 { 1.0 } else { -0.5 }).collect();
        let e = effort(&u, 0.01, -1.0, 1.0);
        // Ten changes of 1.5 in ten seconds.
        assert!((e.travel_per_s - 1.5).abs() < 1e-12);
        assert!((e.saturated - 501.0 / 1001.0).abs() < 1e-12);
        assert!((e.mean - (501.0 - 250.0) / 1001.0).abs() < 1e-12);
        assert!((e.rms - ((501.0 + 125.0) / 1001.0f64).sqrt()).abs() < 1e-12);
        assert_eq!(e.peak, 1.0);
    }

    #[test]
    fn without_limits_nothing_saturates() {
        assert_eq!(effort(&[5.0, -5.0], 0.1, f64::NEG_INFINITY, f64::INFINITY).saturated, 0.0);
        assert_eq!(effort(&[], 0.1, -1.0, 1.0).rms, 0.0);
    }
}
