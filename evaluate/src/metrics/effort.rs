//! Control effort.

use serde::{Deserialize, Serialize};

/// Effort of one input over a run, in the unit of the input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Effort {
    /// SI unit of the input; empty for a pure number.
    #[serde(default)]
    pub unit: String,
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

/// The effort of an input while its samples come.
#[derive(Debug, Clone)]
pub(crate) struct EffortSum {
    lower: f64,
    upper: f64,
    count: u64,
    sum: f64,
    square: f64,
    peak: f64,
    variation: f64,
    at_limit: u64,
    before: Option<f64>,
}

impl EffortSum {
    /// An input with the given limits.
    pub fn new(lower: f64, upper: f64) -> Self {
        let margin = if (upper - lower).is_finite() { 1e-9 * (upper - lower).abs() } else { 0.0 };
        Self {
            lower: lower + margin,
            upper: upper - margin,
            count: 0,
            sum: 0.0,
            square: 0.0,
            peak: 0.0,
            variation: 0.0,
            at_limit: 0,
            before: None,
        }
    }

    /// Takes the next sample, in the unit of the limits.
    pub fn take(&mut self, u: f64) {
        self.count += 1;
        self.sum += u;
        self.square += u * u;
        self.peak = u.abs().max(self.peak);
        self.at_limit += u64::from(u <= self.lower || u >= self.upper);
        if let Some(before) = self.before.replace(u) {
            self.variation += (u - before).abs();
        }
    }

    /// The effort of what came in an input in `unit`, a sample every `period_s` seconds.
    pub fn finish(&self, period_s: f64, unit: String) -> Effort {
        let share = |sum: f64| if self.count > 0 { sum / self.count as f64 } else { 0.0 };
        let length = self.count.saturating_sub(1) as f64 * period_s;
        Effort {
            unit,
            mean: share(self.sum),
            rms: share(self.square).sqrt(),
            peak: self.peak,
            travel_per_s: if self.count > 1 { self.variation / length } else { 0.0 },
            saturated: share(self.at_limit as f64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effort(u: impl IntoIterator<Item = f64>, period_s: f64, lower: f64, upper: f64) -> Effort {
        let mut sum = EffortSum::new(lower, upper);
        u.into_iter().for_each(|u| sum.take(u));
        sum.finish(period_s, String::new())
    }

    #[test]
    fn a_saturated_square_wave() {
        let u = (0..1001).map(|i| if (i / 100) % 2 == 0 { 1.0 } else { -0.5 });
        let e = effort(u, 0.01, -1.0, 1.0);
        // Ten changes of 1.5 in ten seconds.
        assert!((e.travel_per_s - 1.5).abs() < 1e-12);
        assert!((e.saturated - 501.0 / 1001.0).abs() < 1e-12);
        assert!((e.mean - (501.0 - 250.0) / 1001.0).abs() < 1e-12);
        assert!((e.rms - ((501.0 + 125.0) / 1001.0f64).sqrt()).abs() < 1e-12);
        assert_eq!(e.peak, 1.0);
    }

    #[test]
    fn without_limits_nothing_saturates() {
        assert_eq!(effort([5.0, -5.0], 0.1, f64::NEG_INFINITY, f64::INFINITY).saturated, 0.0);
        assert_eq!(effort([], 0.1, -1.0, 1.0).rms, 0.0);
    }
}
