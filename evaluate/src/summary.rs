//! The figures of a run as data, as they stand in `summary.json`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::metrics::{
    Consistency, DisturbanceEvent, Effort, Recovery, StepResponse, Timing, consistency, disturbance_events,
    effort, integral, recovery, setpoint_steps, step_response, timing,
};
use crate::run::Run;

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
    /// Disturbances that set in during the run.
    pub disturbances: Vec<DisturbanceEvent>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputFigures>,
    /// Effort of the inputs, by name.
    pub inputs: BTreeMap<String, Effort>,
    /// Consistency of the estimator.
    pub estimator: Option<Consistency>,
    /// Timing figures.
    pub timing: Timing,
}

/// Figures of one output, in its SI unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputFigures {
    /// SI unit.
    pub unit: String,
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
    /// Every step of the setpoint.
    pub steps: Vec<StepResponse>,
    /// Every disturbance.
    pub disturbances: Vec<Recovery>,
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
    /// Figures of a run.
    pub fn of(run: &Run) -> Self {
        let disturbances = disturbance_events(run);
        let end = run.end_s();
        let first_onset = disturbances.first().map_or(f64::INFINITY, |d| d.at_s);
        let names = run.vehicle.outputs.iter().map(|o| o.name.clone());
        let applied = |i: usize| run.truth.signals.get(run.vehicle.states.len() + i);
        let inputs = run.vehicle.inputs.iter().enumerate().filter_map(|(i, input)| {
            let u = applied(i).filter(|u| !u.is_empty()).or_else(|| run.command.signals.get(i))?;
            Some((input.name.clone(), effort(u, run.period_s(), input.lower, input.upper)))
        });
        Self {
            name: run.name.clone(),
            vehicle: run.vehicle.name.clone(),
            mode: run.info.mode.clone(),
            transport: run.info.transport.clone(),
            seed: run.info.seed,
            period_s: run.period_s(),
            duration_s: end,
            log: run.log.clone(),
            outputs: names
                .enumerate()
                .map(|(i, name)| (name, output_figures(run, i, &disturbances)))
                .collect(),
            inputs: inputs.collect(),
            estimator: consistency(run, first_onset),
            timing: timing(run),
            disturbances,
        }
    }

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

/// The greatest of all values; `None` when there is none, or one of them is `None`.
fn worst(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    values.reduce(|a, b| Some(a?.max(b?))).flatten()
}

fn output_figures(run: &Run, i: usize, events: &[DisturbanceEvent]) -> OutputFigures {
    let output = &run.vehicle.outputs[i];
    let (source, t, y) = run.best(i);
    let (wanted_t, wanted) = (&run.setpoint.t, run.wanted(i));
    let steps_at = setpoint_steps(wanted_t, &wanted);
    let tracked = wanted.iter().any(|w| w.is_finite());
    let held = held(t, wanted_t, &wanted);
    let error: Vec<f64> = held.iter().zip(&y).map(|(w, y)| if w.is_finite() { w - y } else { -y }).collect();
    let duration = t.last().zip(t.first()).map_or(0.0, |(b, a)| b - a);
    let ise = integral(t, &error, |e| e * e);

    let onsets: Vec<f64> = events.iter().map(|e| e.at_s).collect();
    let times: Vec<f64> = steps_at.iter().map(|s| s.0).collect();
    let next = |after: f64, among: &[f64]| {
        among.iter().copied().filter(|t| *t > after + 1e-9).fold(run.end_s(), f64::min)
    };
    // A step of any setpoint moves the other outputs as well: a helicopter rolls to go sideways.
    let moves: Vec<f64> = (0..run.vehicle.outputs.len())
        .flat_map(|j| setpoint_steps(wanted_t, &run.wanted(j)))
        .map(|step| step.0)
        .collect();
    let steps: Vec<StepResponse> = steps_at
        .iter()
        .filter_map(|&(at, to)| step_response(t, &y, at, next(at, &times).min(next(at, &onsets)), to))
        // An error at the start that the sensor could not even see is not a step.
        .filter(|s| (s.to - s.from).abs() > 5.0 * output.noise)
        .collect();
    let disturbances: Vec<Recovery> = onsets
        .iter()
        .filter_map(|&at| {
            let until = recovery_end(at, &onsets, &moves, run.period_s(), run.end_s());
            let part = t.partition_point(|v| *v < at - 1e-9)..t.partition_point(|v| *v <= until + 1e-9);
            let tracked = held.get(part).is_some_and(|w| w.iter().all(|w| w.is_finite()));
            recovery(t, &y, tracked.then_some(&held), at, until)
        })
        .collect();
    let all = |any: bool, all: bool| any.then_some(all);
    OutputFigures {
        unit: output.unit.si_symbol(),
        source: source.into(),
        tracked,
        iae: integral(t, &error, f64::abs),
        ise,
        rms_error: if duration > 0.0 { (ise / duration).sqrt() } else { 0.0 },
        peak: worst(disturbances.iter().map(|d| Some(d.peak))),
        recovery_s: worst(disturbances.iter().map(|d| d.recovery_s)),
        recovered: all(!disturbances.is_empty(), disturbances.iter().all(|d| d.recovery_s.is_some())),
        rise_s: worst(steps.iter().map(|s| s.rise_s)),
        settling_s: worst(steps.iter().map(|s| s.settling_s)),
        settled: all(!steps.is_empty(), steps.iter().all(|s| s.settling_s.is_some())),
        overshoot_percent: worst(steps.iter().map(|s| Some(s.overshoot_percent))),
        steps,
        disturbances,
    }
}

/// The setpoint at the times `t`, held from message to message; NaN where nothing is tracked.
fn held(t: &[f64], wanted_t: &[f64], wanted: &[f64]) -> Vec<f64> {
    let mut at = 0;
    t.iter()
        .map(|t| {
            while at < wanted_t.len() && wanted_t[at] <= t + 1e-9 {
                at += 1;
            }
            let w = if at == 0 { wanted.first() } else { wanted.get(at - 1) };
            w.copied().unwrap_or(f64::NAN)
        })
        .collect()
}

/// Until when the recovery from a disturbance at `at` can be judged: the next onset, the last sample before the next
/// step of a setpoint (the sample of the step already has the new one), or the end of the run.
fn recovery_end(at: f64, onsets: &[f64], steps: &[f64], period_s: f64, end: f64) -> f64 {
    let later = |t: &f64| *t > at + 1e-9;
    let steps = steps.iter().copied().filter(later).map(|t| t - 0.5 * period_s);
    onsets.iter().copied().filter(later).chain(steps).fold(end, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recovery_is_judged_until_something_else_happens() {
        let end = |at| recovery_end(at, &[6.0, 20.0], &[1.0, 32.0, 44.0], 0.01, 56.0);
        assert_eq!((end(6.0), end(20.0), end(50.0)), (20.0, 31.995, 56.0));
    }
}
