//! Control effort.

use serde::{Deserialize, Serialize};
use whirlstand_msgs::units::ShownUnit;

/// Effort of one input over a run, in the unit of the input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Effort {
    /// SI unit of the input; empty for a pure number.
    #[serde(default)]
    pub unit: ShownUnit,
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

/// Accumulates the effort of an input from its samples, in K flights side by side.
#[derive(Debug, Clone)]
pub(crate) struct EffortSum<const K: usize> {
    lower: f64,
    upper: f64,
    count: u64,
    sum: [f64; K],
    square: [f64; K],
    peak: [f64; K],
    variation: [f64; K],
    at_limit: [u64; K],
    before: Option<[f64; K]>,
}

impl<const K: usize> EffortSum<K> {
    /// An input with the given limits.
    pub fn new(lower: f64, upper: f64) -> Self {
        let margin = if (upper - lower).is_finite() { 1e-9 * (upper - lower).abs() } else { 0.0 };
        Self {
            lower: lower + margin,
            upper: upper - margin,
            count: 0,
            sum: [0.0; K],
            square: [0.0; K],
            peak: [0.0; K],
            variation: [0.0; K],
            at_limit: [0; K],
            before: None,
        }
    }

    /// Takes the next sample, in the unit of the limits.
    #[inline(always)]
    pub fn take(&mut self, u: &[f64; K]) {
        self.count += 1;
        // The first sample is no change.
        let before = self.before.replace(*u).unwrap_or(*u);
        for l in 0..K {
            self.sum[l] += u[l];
            self.square[l] += u[l] * u[l];
            self.peak[l] = u[l].abs().max(self.peak[l]);
            self.at_limit[l] += u64::from(u[l] <= self.lower || u[l] >= self.upper);
            self.variation[l] += (u[l] - before[l]).abs();
        }
    }

    /// The effort in flight `l`, of an input in `unit` with a sample every `period_s` seconds.
    pub fn finish(&self, l: usize, period_s: f64, unit: ShownUnit) -> Effort {
        let share = |sum: f64| if self.count > 0 { sum / self.count as f64 } else { 0.0 };
        let length = self.count.saturating_sub(1) as f64 * period_s;
        Effort {
            unit,
            mean: share(self.sum[l]),
            rms: share(self.square[l]).sqrt(),
            peak: self.peak[l],
            travel_per_s: if self.count > 1 { self.variation[l] / length } else { 0.0 },
            saturated: share(self.at_limit[l] as f64),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effort(u: impl IntoIterator<Item = f64>, period_s: f64, lower: f64, upper: f64) -> Effort {
        let mut sum = EffortSum::new(lower, upper);
        u.into_iter().for_each(|u| sum.take(&[u]));
        sum.finish(0, period_s, ShownUnit::default())
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
