//! The figures of a run as data, in the form of `summary.json`.

use std::collections::BTreeMap;
use whirlstand_msgs::units::ShownUnit;

use serde::{Deserialize, Serialize};

use crate::metrics::{Consistency, DisturbanceEvent, Effort, Recovery, StepResponse, Timing};

/// Schema of `summary.json`, which holds one [`RunSummary`] a variant.
pub const SUMMARY_SCHEMA: &str = "whirlstand.summary.v1";

/// Figures of one run, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunSummary {
    /// Name of the variant.
    pub name: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// `realtime` or `lockstep`.
    pub mode: String,
    /// `iceoryx2`, `zenoh` or `inproc`.
    pub transport: String,
    /// Seed of the run.
    pub seed: u64,
    /// Period of the loop, s.
    pub period_s: f64,
    /// Bench time of the last step, s.
    pub duration_s: f64,
    /// Path of the log.
    pub log: String,
    /// Disturbances that set in during the run, at most [`MOST_LISTED`].
    pub disturbances: Vec<DisturbanceEvent>,
    /// Findings of the mirror, at most [`MOST_LISTED`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub findings: Vec<FindingEvent>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputFigures>,
    /// Effort of the inputs, by name.
    pub inputs: BTreeMap<String, Effort>,
    /// Consistency of the estimator.
    pub estimator: Option<Consistency>,
    /// Timing figures.
    pub timing: Timing,
}

/// A finding of the mirror.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FindingEvent {
    /// Bench time, s.
    pub at_s: f64,
    /// Number of the change that the finding concerns.
    pub number: u64,
    /// The sentence.
    pub text: String,
}

/// Figures of one output, in its SI unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputFigures {
    /// SI unit.
    pub unit: ShownUnit,
    /// Which signal was judged: `truth`, `estimate` or `measured`.
    pub source: String,
    /// True when the output had a setpoint; otherwise errors are counted from trim (zero).
    pub tracked: bool,
    /// Integral of the absolute error over the run, unit of the output times s.
    pub iae: f64,
    /// Integral of the squared error over the run, squared unit of the output times s.
    pub ise: f64,
    /// Root of the mean square error over the run.
    pub rms_error: f64,
    /// Greatest distance from the baseline (see [`Recovery`]), over all disturbances; `None` without a disturbance.
    pub peak: Option<f64>,
    /// Longest recovery time, s; `None` without a disturbance or when the output did not recover: see `recovered`.
    pub recovery_s: Option<f64>,
    /// Whether the output came back after every disturbance; `None` without one.
    pub recovered: Option<bool>,
    /// Longest rise time, s; `None` without a step or when 90 % was not reached.
    pub rise_s: Option<f64>,
    /// Longest settling time, s; `None` without a step or when the output did not settle: see `settled`.
    pub settling_s: Option<f64>,
    /// Whether the output settled after every step; `None` without one.
    pub settled: Option<bool>,
    /// Greatest overshoot, % of the step; `None` without a step.
    pub overshoot_percent: Option<f64>,
    /// Every step of the setpoint, at most [`MOST_LISTED`].
    pub steps: Vec<StepResponse>,
    /// Every disturbance, at most [`MOST_LISTED`].
    pub disturbances: Vec<Recovery>,
    /// Number of steps and disturbances that are counted in the figures but not listed.
    #[serde(default, skip_serializing_if = "is_none")]
    pub not_listed: u64,
}

/// Most steps, and most disturbances, that are listed one by one; figures are of all.
pub const MOST_LISTED: usize = 1_000;

fn is_none(count: &u64) -> bool {
    *count == 0
}

/// A figure asked for by its key.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Figure {
    /// Value of the figure, SI.
    Value(f64),
    /// The figure has no value because the output never came back, settled or arrived.
    Never,
    /// The run had no step or disturbance to compute the figure from.
    NoEvent,
}

/// Keys that [`RunSummary::figure`] knows behind the name of an output.
pub const OUTPUT_KEYS: [&str; 8] =
    ["peak", "recovery_s", "rise_s", "settling_s", "overshoot_percent", "iae", "ise", "rms_error"];
/// Keys that [`RunSummary::figure`] knows behind the name of an input.
pub const INPUT_KEYS: [&str; 5] = ["mean", "rms", "peak", "travel_per_s", "saturated"];
/// Keys that [`RunSummary::figure`] knows alone.
pub const RUN_KEYS: [&str; 6] =
    ["deadline_misses", "held_steps", "failsafe_steps", "lost", "restarts", "nis_ratio"];

impl RunSummary {
    /// The figure under a stable key: `roll.peak` and the like ([`OUTPUT_KEYS`]), `u_roll.rms` and the like
    /// ([`INPUT_KEYS`]), or one of [`RUN_KEYS`]. `None` for a key that does not exist here.
    pub fn figure(&self, key: &str) -> Option<Figure> {
        let value = Some;
        if let Some((name, key)) = key.split_once('.') {
            if let Some(output) = self.outputs.get(name) {
                return output.figure(key);
            }
            let input = self.inputs.get(name)?;
            return match key {
                "mean" => value(Figure::Value(input.mean)),
                "rms" => value(Figure::Value(input.rms)),
                "peak" => value(Figure::Value(input.peak)),
                "travel_per_s" => value(Figure::Value(input.travel_per_s)),
                "saturated" => value(Figure::Value(input.saturated)),
                _ => None,
            };
        }
        let timing = &self.timing;
        let count = |n: u64| value(Figure::Value(n as f64));
        match key {
            "deadline_misses" => count(timing.deadline_misses),
            "held_steps" => count(timing.held_steps),
            "failsafe_steps" => count(timing.failsafe_steps),
            "lost" => count(timing.lost),
            "restarts" => count(timing.restarts),
            "nis_ratio" => {
                value(self.estimator.as_ref().map_or(Figure::NoEvent, |e| Figure::Value(e.nis_ratio)))
            }
            _ => None,
        }
    }
}

impl OutputFigures {
    fn figure(&self, key: &str) -> Option<Figure> {
        let event = |v: Option<f64>, any: bool| {
            Some(v.map_or(if any { Figure::Never } else { Figure::NoEvent }, Figure::Value))
        };
        match key {
            "peak" => event(self.peak, false),
            "recovery_s" => event(self.recovery_s, self.recovered.is_some()),
            "rise_s" => event(self.rise_s, !self.steps.is_empty()),
            "settling_s" => event(self.settling_s, self.settled.is_some()),
            "overshoot_percent" => event(self.overshoot_percent, false),
            "iae" => Some(Figure::Value(self.iae)),
            "ise" => Some(Figure::Value(self.ise)),
            "rms_error" => Some(Figure::Value(self.rms_error)),
            _ => None,
        }
    }
}
