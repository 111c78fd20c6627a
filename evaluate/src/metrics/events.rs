//! When something happened in a run: steps of the setpoint and onsets of disturbances.

use serde::{Deserialize, Serialize};

use crate::run::Run;
use whirlstand_logs::stats::median;

/// A disturbance that set in during a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DisturbanceEvent {
    /// Onset, s.
    pub at_s: f64,
    /// Time at which the disturbance was back at its value before the onset, s; the end of the run if never.
    pub until_s: f64,
    /// The state on whose derivative the disturbance acts most, relative to the largest disturbance of that state in
    /// the run.
    #[serde(rename = "where")]
    pub place: String,
    /// Change of that derivative at the onset, SI.
    pub magnitude: f64,
}

/// Onsets of disturbances in a run, in the order of time.
///
/// What is published at every step (turbulence, a sine) sets in where it starts, unless that is the first step,
/// and where it jumps by ten times the median of its changes. Onsets within 50 ms of each other are one.
pub fn disturbance_events(run: &Run) -> Vec<DisturbanceEvent> {
    let t = &run.disturbance.t;
    let end = run.end_s();
    let first_step = 1.5 * run.period_s();
    let mut events: Vec<DisturbanceEvent> = Vec::new();
    for (signal, state) in run.disturbance.signals.iter().zip(&run.vehicle.states) {
        let mut before = 0.0;
        let changes: Vec<(usize, f64)> = signal
            .iter()
            .enumerate()
            .map(|(i, v)| (i, v - std::mem::replace(&mut before, *v)))
            .filter(|(_, change)| *change != 0.0)
            .collect();
        let sizes: Vec<f64> = changes.iter().map(|(_, c)| c.abs()).collect();
        let continuous = changes.len() > 20;
        let threshold = if continuous { 10.0 * median(&sizes) } else { 0.0 };
        for (i, change) in changes {
            let old = signal[i] - change;
            // The end of a pulse is not a disturbance of its own.
            let ends = signal[i].abs() < old.abs() && old.signum() == -change.signum();
            let starts = i == 0 || continuous && signal[..i].iter().all(|v| *v == 0.0);
            if ends && !continuous || change.abs() <= threshold && !starts || starts && t[i] < first_step {
                continue;
            }
            let back = signal[i..].iter().position(|v| (v - old).abs() < 0.5 * change.abs());
            let until_s = back.map_or(end, |k| t[i + k]);
            events.push(DisturbanceEvent {
                at_s: t[i],
                until_s,
                place: state.name.clone(),
                magnitude: change,
            });
        }
    }
    events.sort_by(|a, b| a.at_s.total_cmp(&b.at_s));
    let mut merged: Vec<DisturbanceEvent> = Vec::new();
    for event in events {
        match merged.last_mut() {
            Some(last) if event.at_s - last.at_s < 0.05 => {
                last.until_s = last.until_s.max(event.until_s);
                if !last.place.split(", ").any(|p| p == event.place) {
                    last.place = format!("{}, {}", last.place, event.place);
                }
                if event.magnitude.abs() > last.magnitude.abs() {
                    last.magnitude = event.magnitude;
                }
            }
            _ => merged.push(event),
        }
    }
    merged
}

/// Steps of a setpoint: `(time, new value)`. Starts with the first value that is tracked; a value that does not
/// last a tenth of a second is part of a ramp, which has no step response.
pub fn setpoint_steps(t: &[f64], wanted: &[f64]) -> Vec<(f64, f64)> {
    let mut steps: Vec<(f64, f64)> = Vec::new();
    let mut before = f64::NAN;
    for (t, w) in t.iter().zip(wanted) {
        if w.is_finite() && *w != before {
            steps.push((*t, *w));
        }
        before = *w;
    }
    let end = t.last().copied().unwrap_or(0.0);
    let lasting: Vec<bool> =
        (0..steps.len()).map(|i| steps.get(i + 1).map_or(end + 0.1, |s| s.0) - steps[i].0 >= 0.1).collect();
    steps.into_iter().zip(lasting).filter(|(_, lasts)| *lasts).map(|(s, _)| s).collect()
}
