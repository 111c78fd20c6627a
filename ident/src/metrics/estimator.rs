//! Whether the estimator tells the truth about its own errors.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use whirlstand_msgs::flags;

use crate::run::Run;
use crate::stats::{chi_square_quantile, rms};

/// Errors of one estimated state against the truth, SI.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StateError {
    /// Root of the mean square error.
    pub rms: f64,
    /// Root of the mean variance that the estimator claims.
    pub claimed_std: f64,
    /// Share of the steps with an error within twice the claimed standard deviation; 0.954 for a consistent
    /// estimator with Gaussian errors.
    pub within_two_std: f64,
}

/// Consistency of the estimator over a run, from convergence to the first disturbance (to the end without one).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Consistency {
    /// Mean of the normalised innovation squared over its degrees of freedom; 1 for a consistent filter.
    pub nis_ratio: f64,
    /// Lower end of the interval that holds `nis_ratio` with 95 % probability if the filter is consistent
    /// (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2).
    pub low: f64,
    /// Upper end of that interval.
    pub high: f64,
    /// `low <= nis_ratio <= high`.
    pub consistent: bool,
    /// Number of steps used.
    pub steps: usize,
    /// Errors of the states, by name, over the same part; empty without truth.
    pub states: BTreeMap<String, StateError>,
}

const Z95: f64 = 1.959_964;

/// Bounds of the mean NIS over its degrees of freedom, 95 %, for that many degrees of freedom in all.
pub(crate) fn nis_bounds(degrees: f64) -> (f64, f64) {
    (chi_square_quantile(degrees, -Z95) / degrees, chi_square_quantile(degrees, Z95) / degrees)
}

/// Judges the estimator of `run` until `until_s`. `None` without a converged estimate with a NIS.
pub fn consistency(run: &Run, until_s: f64) -> Option<Consistency> {
    let n = run.vehicle.states.len();
    let estimate = &run.estimate;
    let column = |i: usize| estimate.signals.get(2 * n + i);
    let (nis, dof, flag) = (column(0)?, column(1)?, column(2)?);
    let converged = |k: &usize| flag[*k] as u32 & flags::CONVERGED != 0 && estimate.t[*k] < until_s;
    let used: Vec<usize> = (0..estimate.t.len()).filter(converged).collect();
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
        steps: used.len(),
        states,
    })
}
