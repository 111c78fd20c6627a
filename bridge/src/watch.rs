//! Detects an estimate that is inconsistent with the measurements.

use std::time::Duration;

/// Time over which the innovations are averaged.
const AVERAGE: Duration = Duration::from_millis(200);

/// Averages the normalised innovation squared of the estimator. Its expectation is its degrees of freedom; a
/// diverged estimate has a far larger one (Bar-Shalom, Estimation with Applications to Tracking and
/// Navigation, 5.4).
#[derive(Debug, Clone)]
pub struct EstimateWatch {
    limit: f64,
    average: f64,
    at: Option<Duration>,
    finite: bool,
}

impl EstimateWatch {
    /// A watch with an alarm when the average is more than `limit` times its expectation.
    pub fn new(limit: f64) -> Self {
        Self { limit, average: 1.0, at: None, finite: true }
    }

    /// Processes an estimate: its states, its normalised innovation squared and the degrees of freedom.
    pub fn observe(&mut self, states: &[f64], nis: f64, dof: u32, now: Duration) {
        self.finite = nis.is_finite() && states.iter().all(|x| x.is_finite());
        if dof == 0 || !self.finite {
            return;
        }
        let step = self.at.map_or(Duration::ZERO, |at| now.saturating_sub(at));
        self.at = Some(now);
        let keep = (-step.as_secs_f64() / AVERAGE.as_secs_f64()).exp();
        self.average = keep * self.average + (1.0 - keep) * nis / f64::from(dof);
    }

    /// True while the estimate is consistent.
    pub fn is_good(&self) -> bool {
        self.finite && self.average <= self.limit
    }

    /// Averaged normalised innovation squared over its expectation; 1 for a consistent filter.
    pub fn ratio(&self) -> f64 {
        self.average
    }

    /// Resets for a new run.
    pub fn reset(&mut self) {
        *self = Self::new(self.limit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(watch: &mut EstimateWatch, from_ms: u64, to_ms: u64, nis: f64) -> Option<u64> {
        (from_ms..to_ms).step_by(5).find(|ms| {
            watch.observe(&[0.0; 4], nis, 2, Duration::from_millis(*ms));
            !watch.is_good()
        })
    }

    #[test]
    fn a_diverging_estimate_is_noticed_within_the_stated_time_and_an_outlier_is_not() {
        let mut watch = EstimateWatch::new(100.0);
        assert_eq!(run(&mut watch, 0, 2000, 2.0), None);
        assert_eq!(run(&mut watch, 2000, 2005, 2000.0), None, "one outlier of 30 sigma is no divergence");
        assert_eq!(run(&mut watch, 2005, 4000, 2.0), None);
        let noticed = run(&mut watch, 4000, 6000, 2000.0).unwrap();
        assert!((4010..4100).contains(&noticed), "{noticed}");
    }

    #[test]
    fn what_is_not_a_number_is_noticed_at_once() {
        let mut watch = EstimateWatch::new(100.0);
        watch.observe(&[0.0, f64::NAN], 1.0, 1, Duration::ZERO);
        assert!(!watch.is_good());
        watch.observe(&[0.0, 0.0], f64::INFINITY, 1, Duration::ZERO);
        assert!(!watch.is_good());
        watch.reset();
        assert!(watch.is_good());
    }
}
