//! Consistency of the estimator: its errors compared with the covariance that it claims.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use whirlstand_msgs::flags;

use crate::run::Run;
use whirlstand_logs::stats::{chi_square_quantile, rms};

/// Errors of one estimated state against the truth, SI.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StateError {
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

/// A claimed standard deviation this close to the one at the end of the part has converged.
const CONVERGED_WITHIN: f64 = 1.1;

/// Consistency of the estimator of `run` until bench time `until_s`, s. `None` without an estimate with a NIS.
///
/// Convergence is what the estimator flags. One that flags nothing before `until_s` (the gains of a filter with bias
/// states go on falling, slowly, for minutes) is judged from where the standard deviation of every state has come
/// within 10 % of what it is at `until_s`.
pub fn consistency(run: &Run, until_s: f64) -> Option<Consistency> {
    let n = run.vehicle.states.len();
    let estimate = &run.estimate;
    let column = |i: usize| estimate.signals.get(2 * n + i);
    let (nis, dof, flag) = (column(0)?, column(1)?, column(2)?);
    let end = estimate.t.partition_point(|t| *t < until_s);
    let flagged: Vec<usize> = (0..end).filter(|&k| flag[k] as u32 & flags::CONVERGED != 0).collect();
    let used = if flagged.is_empty() { (settled_from(run, end)..end).collect() } else { flagged };
    let judged = || used.iter().filter(|&&k| dof[k] > 0.0 && nis[k].is_finite());
    let degrees: f64 = judged().map(|&k| dof[k]).sum();
    if degrees == 0.0 {
        return None;
    }
    let nis_ratio = judged().map(|&k| nis[k]).sum::<f64>() / degrees;
    let (low, high) = nis_bounds(degrees);
    let mut states = BTreeMap::new();
    for (i, state) in run.vehicle.states.iter().enumerate() {
        let (mut errors, mut claimed) = (Vec::new(), Vec::new());
        for &k in &used {
            // Truth and estimate of a step have one stamp.
            let at = run.truth.t.partition_point(|t| *t < estimate.t[k] - 1e-10);
            if run.truth.t.get(at).is_some_and(|t| (t - estimate.t[k]).abs() < 1e-9) {
                errors.push(estimate.signals[i][k] - run.truth.signals[i][at]);
                claimed.push(estimate.signals[n + i][k]);
            }
        }
        if errors.is_empty() {
            continue;
        }
        let inside = errors.iter().zip(&claimed).filter(|(e, s)| e.abs() <= 2.0 * **s).count();
        states.insert(
            state.name.clone(),
            StateError {
                rms: rms(&errors),
                claimed_std: rms(&claimed),
                within_two_std: inside as f64 / errors.len() as f64,
            },
        );
    }
    Some(Consistency {
        nis_ratio,
        low,
        high,
        consistent: (low..=high).contains(&nis_ratio),
        from_s: used.first().map_or(0.0, |&k| estimate.t[k]),
        steps: used.len(),
        states,
    })
}

/// First step from which on no state claims a standard deviation beyond [`CONVERGED_WITHIN`] times the one at step
/// `end - 1`.
fn settled_from(run: &Run, end: usize) -> usize {
    let n = run.vehicle.states.len();
    let Some(last) = end.checked_sub(1) else { return 0 };
    let unsettled =
        |k: &usize| run.estimate.signals[n..2 * n].iter().any(|std| std[*k] > CONVERGED_WITHIN * std[last]);
    (0..end).rev().find(unsettled).map_or(0, |k| k + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_logs::BenchInfo;
    use whirlstand_logs::testing::noise;
    use whirlstand_msgs::{Estimate, Head, Message};
    use whirlstand_vehicle::Vehicle;

    /// A run whose filter claims `1 + 5 exp(-t)` and whose innovations have `scale` times their claimed size.
    fn run(scale: f64, flag_from: Option<u64>) -> Run {
        let mut run =
            Run::empty("run", BenchInfo::default(), Vehicle::builtin("quadrotor").expect("it is built in"));
        let e = noise(8_000, 17);
        for k in 0..2_000u64 {
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
            run.take_estimate(&estimate);
        }
        run
    }

    #[test]
    fn a_filter_that_flags_nothing_is_judged_once_its_claims_have_come_down() {
        let c = consistency(&run(1.0, None), 9.0).expect("a figure");
        // 5 exp(-t) is a tenth of what is claimed at 9 s, 1 + 5 exp(-9), at 3.9 s.
        assert!((c.from_s - 3.91).abs() < 0.02, "{c:?}");
        assert!(c.consistent && c.low < 1.0 && c.high > 1.0, "{c:?}");
        assert!((c.steps as f64 - (9.0 - c.from_s) / 5e-3).abs() < 2.0);
    }

    #[test]
    fn what_the_estimator_flags_goes_first() {
        let c = consistency(&run(1.0, Some(400)), 9.0).expect("a figure");
        assert!((c.from_s - 2.0).abs() < 1e-9, "{c:?}");
    }

    #[test]
    fn an_overconfident_filter_is_not_consistent() {
        let c = consistency(&run(1.3, None), f64::INFINITY).expect("a figure");
        assert!(!c.consistent && (c.nis_ratio - 1.69).abs() < 0.1, "{c:?}");
        assert!(consistency(&run(1.0, None), 0.0).is_none());
    }
}
