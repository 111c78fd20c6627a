//! Consistency of the estimator: its errors compared with the covariance that it claims.

use std::collections::BTreeMap;
use whirlstand_msgs::units::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_logs::stats::chi_square_quantile;
use whirlstand_msgs::{Estimate, flags};

/// Errors of one estimated state against the truth, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StateError {
    /// SI unit of the state; empty for a pure number.
    #[serde(default)]
    pub unit: ShownUnit,
    /// Root of the mean square error, SI.
    pub rms: f64,
    /// Root of the mean variance that the estimator claims, SI.
    pub claimed_std: f64,
    /// Share of the steps with an error within twice the claimed standard deviation; 0.954 for a consistent
    /// estimator with Gaussian errors.
    pub within_two_std: f64,
}

/// Consistency of the estimator over a run, from convergence to the first disturbance or to the end of the run. Later
/// innovations contain the disturbance, which the filter does not know of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    /// Mean of the normalised innovation squared over its degrees of freedom; 1 for a consistent filter.
    pub nis_ratio: f64,
    /// Lower end of the interval that holds `nis_ratio` with 95 % probability if the filter is consistent
    /// (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2).
    pub low: f64,
    /// Upper end of the interval whose lower end is `low`.
    pub high: f64,
    /// Whether `low <= nis_ratio <= high`.
    pub consistent: bool,
    /// Bench time from which on the filter is judged, s.
    pub from_s: f64,
    /// Number of steps used.
    pub steps: usize,
    /// Errors of the states, by name, over the same part; empty without truth.
    pub states: BTreeMap<String, StateError>,
}

/// Bounds within which the mean NIS over its degrees of freedom lies with 95 % probability, for `degrees` degrees of
/// freedom in all.
pub fn nis_bounds(degrees: f64) -> (f64, f64) {
    (chi_square_quantile(0.025, degrees) / degrees, chi_square_quantile(0.975, degrees) / degrees)
}

/// Ratio of a claimed standard deviation to the one at the end of the part below which it has converged.
const CONVERGED_WITHIN: f64 = 1.1;

/// Sums over the errors of one state.
#[derive(Debug, Clone, Copy, Default)]
struct ErrorSum {
    square: f64,
    claimed: f64,
    inside: u64,
    count: u64,
}

/// Sums over the evaluated steps.
#[derive(Debug, Clone, Default)]
struct Sums {
    nis: f64,
    degrees: f64,
    from_s: f64,
    steps: usize,
    states: Vec<ErrorSum>,
}

impl Sums {
    fn take(&mut self, t: f64, estimate: &Estimate, truth: Option<&[f64]>, states: usize) {
        self.take_innovation(t, estimate.nis, estimate.dof);
        self.states.resize(states, ErrorSum::default());
        let Some(truth) = truth else { return };
        for (((sum, x), std), truth) in self.states.iter_mut().zip(&estimate.x).zip(&estimate.std).zip(truth)
        {
            let error = x - truth;
            sum.square += error * error;
            sum.claimed += std * std;
            sum.inside += u64::from(error.abs() <= 2.0 * std);
            sum.count += 1;
        }
    }

    fn take_innovation(&mut self, t: f64, nis: f64, dof: u32) {
        if self.steps == 0 {
            self.from_s = t;
        }
        self.steps += 1;
        let degrees = f64::from(dof);
        if degrees > 0.0 && nis.is_finite() {
            self.nis += nis;
            self.degrees += degrees;
        }
    }
}

/// The values of an estimate that are needed for its consistency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Claim {
    /// Time, s.
    pub t: f64,
    pub nis: f64,
    pub dof: u32,
    pub converged: bool,
}

/// Accumulates the consistency of an estimator from its estimates.
///
/// Convergence is taken from the estimator's flag. An estimator that never sets it until the end of the part (the
/// gains of a filter with bias states decrease slowly for minutes) is evaluated from the time at which the
/// standard deviation of every state is within 10 % of its final value.
#[derive(Debug, Clone)]
pub(crate) struct ConsistencySum {
    until_s: f64,
    states: usize,
    /// Greatest claimed standard deviation of each state that counts as converged.
    most_claimed: Vec<f64>,
    flagged: Sums,
    settled: Sums,
}

impl ConsistencySum {
    /// Judges `states` states until bench time `until_s`, s, where the filter claims the standard deviations `claimed`.
    pub fn new(states: usize, until_s: f64, claimed: &[f64]) -> Self {
        let most_claimed = claimed.iter().take(states).map(|std| CONVERGED_WITHIN * std).collect();
        Self { until_s, states, most_claimed, flagged: Sums::default(), settled: Sums::default() }
    }

    /// Takes the estimate of time `t`, s, and the true states of the same step.
    pub fn take(&mut self, t: f64, estimate: &Estimate, truth: Option<&[f64]>) {
        if t >= self.until_s {
            return;
        }
        if estimate.flags & flags::CONVERGED != 0 {
            self.flagged.take(t, estimate, truth, self.states);
        }
        if estimate.std.iter().zip(&self.most_claimed).any(|(std, most)| std > most) {
            self.settled = Sums::default();
        } else if self.flagged.steps == 0 {
            self.settled.take(t, estimate, truth, self.states);
        }
    }

    /// As [`Self::take`], for the ratio alone; `std` are the claimed standard deviations.
    pub fn take_claim(&mut self, claim: &Claim, std: &[f64]) {
        if claim.t >= self.until_s {
            return;
        }
        if claim.converged {
            self.flagged.take_innovation(claim.t, claim.nis, claim.dof);
        }
        if std.iter().zip(&self.most_claimed).any(|(std, most)| std > most) {
            self.settled = Sums::default();
        } else if self.flagged.steps == 0 {
            self.settled.take_innovation(claim.t, claim.nis, claim.dof);
        }
    }

    /// The consistency, with the names of the states and their SI units; `None` without an estimate with a NIS.
    pub fn finish(self, states: impl IntoIterator<Item = (String, ShownUnit)>) -> Option<Consistency> {
        let sums = if self.flagged.steps > 0 { self.flagged } else { self.settled };
        if sums.degrees == 0.0 {
            return None;
        }
        let nis_ratio = sums.nis / sums.degrees;
        let (low, high) = nis_bounds(sums.degrees);
        let states = states.into_iter().zip(&sums.states).filter(|(_, sum)| sum.count > 0).map(
            |((name, unit), sum)| {
                let count = sum.count as f64;
                let error = StateError {
                    unit,
                    rms: (sum.square / count).sqrt(),
                    claimed_std: (sum.claimed / count).sqrt(),
                    within_two_std: sum.inside as f64 / count,
                };
                (name, error)
            },
        );
        Some(Consistency {
            nis_ratio,
            low,
            high,
            consistent: (low..=high).contains(&nis_ratio),
            from_s: sums.from_s,
            steps: sums.steps,
            states: states.collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{Head, Message};
    use whirlstand_test_harness::noise;

    /// Consistency until `until_s` of a filter that claims `1 + 5 exp(-t)` and whose innovations have `scale` times their
    /// claimed size.
    fn consistency(scale: f64, flag_from: Option<u64>, until_s: f64) -> Option<Consistency> {
        let e = noise(8_000, 17);
        let estimates: Vec<Estimate> = (0..2_000u64)
            .map(|k| {
                let t = k as f64 * 5e-3;
                let at = 4 * k as usize;
                let mut estimate = Estimate {
                    head: Head { seq: k, step: k, stamp_ns: k * 5_000_000 },
                    nis: e[at..at + 4].iter().map(|v| (scale * v).powi(2)).sum(),
                    dof: 4,
                    count: 4,
                    flags: if flag_from.is_some_and(|from| k >= from) { flags::CONVERGED } else { 0 },
                    ..Estimate::zeroed()
                };
                estimate.std[..4].fill(1.0 + 5.0 * (-t).exp());
                estimate
            })
            .collect();
        let time = |estimate: &Estimate| estimate.head.stamp_ns as f64 * 1e-9;
        let last = estimates.iter().rfind(|estimate| time(estimate) < until_s)?;
        let mut sum = ConsistencySum::new(4, until_s, &last.std);
        estimates.iter().for_each(|estimate| sum.take(time(estimate), estimate, None));
        sum.finish([])
    }

    #[test]
    fn a_filter_that_flags_nothing_is_judged_once_its_claims_have_come_down() {
        let c = consistency(1.0, None, 9.0).expect("a figure");
        // 5 exp(-t) is a tenth of what is claimed at 9 s, 1 + 5 exp(-9), at 3.9 s.
        assert!((c.from_s - 3.91).abs() < 0.02, "{c:?}");
        assert!(c.consistent && c.low < 1.0 && c.high > 1.0, "{c:?}");
        assert!((c.steps as f64 - (9.0 - c.from_s) / 5e-3).abs() < 2.0);
    }

    #[test]
    fn what_the_estimator_flags_goes_first() {
        let c = consistency(1.0, Some(400), 9.0).expect("a figure");
        assert!((c.from_s - 2.0).abs() < 1e-9, "{c:?}");
    }

    #[test]
    fn an_overconfident_filter_is_not_consistent() {
        let c = consistency(1.3, None, f64::INFINITY).expect("a figure");
        assert!(!c.consistent && (c.nis_ratio - 1.69).abs() < 0.1, "{c:?}");
        assert!(consistency(1.0, None, 0.0).is_none());
    }
}
