//! Events of a run: steps of the setpoint and onsets of disturbances.

use std::collections::BTreeMap;
use whirlstand_msgs::units::ShownUnit;

use serde::{Deserialize, Serialize};

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
    /// SI unit of that derivative.
    #[serde(default)]
    pub unit: ShownUnit,
}

/// Number of changes up to which their median is exact; beyond that it comes from a histogram.
const EXACT_CHANGES: usize = 1 << 16;

/// Bits of a float below the ten leading bits of its mantissa: numbers that agree in all other bits are in one
/// bucket, within a thousandth of each other.
const BUCKET_BITS: u32 = 42;

/// Sizes of the changes of a disturbance from message to message.
#[derive(Debug, Clone, Default)]
pub(crate) struct Changes {
    before: f64,
    count: usize,
    first: Vec<f64>,
    buckets: BTreeMap<u64, usize>,
}

impl Changes {
    /// Takes the next value.
    pub fn take(&mut self, value: f64) {
        let change = (value - std::mem::replace(&mut self.before, value)).abs();
        if change == 0.0 {
            return;
        }
        self.count += 1;
        if self.first.len() < EXACT_CHANGES {
            self.first.push(change);
        }
        *self.buckets.entry(change.to_bits() >> BUCKET_BITS).or_default() += 1;
    }

    /// Whether the disturbance is published at every step, as turbulence or a sine are.
    fn continuous(&self) -> bool {
        self.count > 20
    }

    fn median(&self) -> f64 {
        if self.count <= self.first.len() {
            return median(&self.first);
        }
        let mut seen = 0;
        let middle = self.buckets.iter().find(|(_, count)| {
            seen += **count;
            2 * seen >= self.count
        });
        middle.map_or(0.0, |(bucket, _)| f64::from_bits(bucket << BUCKET_BITS))
    }
}

/// The disturbance of one state's derivative during the search for onsets.
#[derive(Debug, Clone)]
struct StateOnsets {
    name: String,
    /// SI unit of its derivative.
    unit: ShownUnit,
    continuous: bool,
    threshold: f64,
    before: f64,
    /// Whether all values so far were zero.
    still: bool,
    /// Onsets that have not ended: value before, change, number of the event.
    open: Vec<(f64, f64, usize)>,
}

/// Finds the onsets of disturbances in a run, in the order of time.
///
/// What is published at every step (turbulence, a sine) sets in where it starts, unless that is the first step,
/// and where it jumps by ten times the median of its changes. Onsets within 50 ms of each other are one.
#[derive(Debug, Clone)]
pub(crate) struct Onsets {
    states: Vec<StateOnsets>,
    any: bool,
    first_step_s: f64,
    end_s: f64,
    events: Vec<DisturbanceEvent>,
}

impl Onsets {
    /// `changes` are those of the states, given by name and by the SI unit of the derivative, over the whole run, which ends
    /// at `end_s`.
    pub fn new(states: &[(String, ShownUnit)], changes: &[Changes], period_s: f64, end_s: f64) -> Self {
        let states = states.iter().zip(changes).map(|((name, unit), changes)| StateOnsets {
            name: name.clone(),
            unit: unit.clone(),
            continuous: changes.continuous(),
            threshold: if changes.continuous() { 10.0 * changes.median() } else { 0.0 },
            before: 0.0,
            still: true,
            open: Vec::new(),
        });
        Self { states: states.collect(), any: false, first_step_s: 1.5 * period_s, end_s, events: Vec::new() }
    }

    /// Takes the next message: its time, and the disturbance of every state's derivative.
    pub fn take(&mut self, t: f64, values: &[f64]) {
        let first = !std::mem::replace(&mut self.any, true);
        for (state, value) in self.states.iter_mut().zip(values.iter().copied()) {
            let events = &mut self.events;
            state.open.retain(|(old, change, event)| {
                let over = (value - old).abs() < 0.5 * change.abs();
                if over {
                    events[*event].until_s = t;
                }
                !over
            });
            let old = std::mem::replace(&mut state.before, value);
            let still = state.still;
            state.still &= value == 0.0;
            let change = value - old;
            if change == 0.0 {
                continue;
            }
            // The end of a pulse is not counted as a disturbance.
            let ends = value.abs() < old.abs() && old.signum() == -change.signum();
            let starts = first || state.continuous && still;
            if ends && !state.continuous
                || change.abs() <= state.threshold && !starts
                || starts && t < self.first_step_s
            {
                continue;
            }
            state.open.push((old, change, events.len()));
            events.push(DisturbanceEvent {
                at_s: t,
                until_s: self.end_s,
                place: state.name.clone(),
                magnitude: change,
                unit: state.unit.clone(),
            });
        }
    }

    /// The onsets.
    pub fn finish(self) -> Vec<DisturbanceEvent> {
        let mut merged: Vec<DisturbanceEvent> = Vec::new();
        for event in self.events {
            match merged.last_mut() {
                Some(last) if event.at_s - last.at_s < 0.05 => {
                    last.until_s = last.until_s.max(event.until_s);
                    if !last.place.split(", ").any(|p| p == event.place) {
                        last.place = format!("{}, {}", last.place, event.place);
                    }
                    if event.magnitude.abs() > last.magnitude.abs() {
                        (last.magnitude, last.unit) = (event.magnitude, event.unit);
                    }
                }
                _ => merged.push(event),
            }
        }
        merged
    }
}

/// How long a setpoint has to last for its change to be a step: what changes faster is part of a ramp, which has no
/// step response; s.
const LASTING_S: f64 = 0.1;

/// Finds the steps of a setpoint, which start with the first value that is tracked.
#[derive(Debug, Clone)]
pub(crate) struct SetpointSteps {
    steps: Vec<(f64, f64)>,
    before: f64,
}

impl SetpointSteps {
    /// Before the first message.
    pub fn new() -> Self {
        Self { steps: Vec::new(), before: f64::NAN }
    }

    /// Takes the setpoint at time `t`, s; NaN where nothing is tracked. A time before that of the last message forgets what
    /// came from then on.
    pub fn take(&mut self, t: f64, wanted: f64) {
        if self.steps.last().is_some_and(|step| step.0 >= t) {
            self.steps.truncate(self.steps.partition_point(|step| step.0 < t));
            self.before = self.steps.last().map_or(f64::NAN, |step| step.1);
        }
        if wanted.is_finite() && wanted != self.before {
            self.steps.pop_if(|last| t - last.0 < LASTING_S);
            self.steps.push((t, wanted));
        }
        self.before = wanted;
    }

    /// Time and new value of every step.
    pub fn finish(self) -> Vec<(f64, f64)> {
        self.steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    fn onsets(rows: &[(f64, f64)]) -> Vec<DisturbanceEvent> {
        let mut changes = Changes::default();
        rows.iter().for_each(|(_, v)| changes.take(*v));
        let mut onsets =
            Onsets::new(&[("roll_rate".to_string(), ShownUnit::of("rad/s^2"))], &[changes], 1e-3, 100.0);
        rows.iter().for_each(|(t, v)| onsets.take(*t, &[*v]));
        onsets.finish()
    }

    #[test]
    fn a_pulse_is_one_event_and_a_step_lasts() {
        let events = onsets(&[(6.0, 3.0), (6.2, 0.0), (20.0, -1.0)]);
        let found: Vec<_> = events.iter().map(|e| (e.at_s, e.until_s, e.magnitude)).collect();
        assert_eq!(found, [(6.0, 6.2, 3.0), (20.0, 100.0, -1.0)]);
    }

    #[test]
    fn a_gust_stands_out_of_turbulence_of_any_length() {
        // More changes than are kept exactly.
        for n in [5_000, 2 * EXACT_CHANGES] {
            let e = noise(n, 3);
            let gust = |i: usize| if (4_000..4_100).contains(&i) { 50.0 } else { 0.0 };
            let rows: Vec<_> = (0..n).map(|i| (i as f64 * 1e-3, 0.1 * e[i] + gust(i))).collect();
            let events = onsets(&rows);
            let found: Vec<_> = events.iter().map(|e| (e.at_s, e.until_s.to_bits())).collect();
            assert_eq!(found, [(4.0, 4.1f64.to_bits()), (4.1, events[1].until_s.to_bits())], "{events:?}");
        }
    }

    #[test]
    fn the_median_of_many_changes_is_within_a_thousandth() {
        let mut changes = Changes::default();
        let n = 4 * EXACT_CHANGES;
        let (mut value, mut sizes) = (0.0, Vec::new());
        for e in noise(n, 5) {
            value += e;
            changes.take(value);
            sizes.push(e.abs());
        }
        let exact = median(&sizes);
        assert!((changes.median() / exact - 1.0).abs() < 2e-3, "{} {exact}", changes.median());
        assert!(changes.first.len() == EXACT_CHANGES && changes.buckets.len() < 40_000);
    }

    #[test]
    fn a_ramp_has_no_steps_but_its_end() {
        let mut steps = SetpointSteps::new();
        for k in 0..300 {
            let t = k as f64 * 0.01;
            steps.take(t, if t < 1.0 { 0.0 } else { (t - 1.0).min(1.0) });
        }
        let found = steps.finish();
        assert_eq!(found.len(), 2, "{found:?}");
        assert_eq!(found[0], (0.0, 0.0));
        assert!((found[1].0 - 2.0).abs() < 1e-9);
    }

    #[test]
    fn a_restart_forgets_later_steps() {
        let mut steps = SetpointSteps::new();
        for (t, w) in [(0.0, 0.0), (1.0, 1.0), (3.0, 0.0), (0.0, 0.0), (1.0, 2.0)] {
            steps.take(t, w);
        }
        assert_eq!(steps.finish(), [(0.0, 0.0), (1.0, 2.0)]);
    }
}
