//! The first pass over a run's log: selects the valid messages, and finds the times of events.

use whirlstand_logs::finding_text::finding_text;
use whirlstand_logs::{BenchMessage, Hole, Log, ReadError};
use whirlstand_msgs::units::ShownUnit;
use whirlstand_msgs::{Disturbance, Estimate, Finding, Health, Setpoint, flags};
use whirlstand_vehicle::Vehicle;

use crate::health::NodeHealth;
use crate::kept::{Again, Kept};
use crate::layout::{Layout, NS, seconds};
use crate::merge::{LOOP, TOPICS, place};
use crate::metrics::{Changes, ChargeSteps, DisturbanceEvent, Onsets, Part, SetpointSteps};
use crate::summary::{FindingEvent, MOST_LISTED};

/// Most stored messages on disturbances; a run with more of them is read once more for its onsets.
const MOST_DISTURBANCES: usize = 1 << 14;

/// The data of a run that are needed before its figures can be computed.
pub(crate) struct Survey {
    /// The valid messages of each topic, in the order of [`place`].
    pub kept: [Kept; TOPICS],
    /// Health of the nodes.
    pub health: Vec<NodeHealth>,
    /// Bench time of the last step, s.
    pub end_s: f64,
    /// Onsets of disturbances.
    pub onsets: Vec<DisturbanceEvent>,
    /// Whether each output has a setpoint.
    pub tracked: Vec<bool>,
    /// Standard deviations that the estimator claims just before the first disturbance, or at the end.
    pub claimed: Vec<f64>,
    /// Holes of the log, in which messages could not be written.
    pub holes: Vec<Hole>,
    /// Who was in charge behind a bridge.
    pub charge: ChargeSteps,
    /// Findings of the mirror.
    pub findings: Vec<FindingEvent>,
    /// Time and new value of the setpoint's steps, for each output.
    steps: Vec<Vec<(f64, f64)>>,
    period_s: f64,
}

/// The survey while the log is read.
struct Reading<'a> {
    layout: &'a Layout,
    kept: [Kept; TOPICS],
    health: Vec<NodeHealth>,
    tracked: Vec<bool>,
    steps: Vec<SetpointSteps>,
    disturbances: Disturbances,
    claimed: Vec<f64>,
    charge: ChargeSteps,
    findings: Vec<FindingEvent>,
    /// When the estimator first said that it has converged, s.
    converged_s: Option<f64>,
}

/// Disturbances that the plant published.
#[derive(Default)]
struct Disturbances {
    kept: Kept,
    changes: Vec<Changes>,
    /// The messages, as long as there are not too many.
    rows: Option<Vec<(f64, Vec<f64>)>>,
}

impl Disturbances {
    fn new(states: usize) -> Self {
        Self { changes: vec![Changes::default(); states], rows: Some(Vec::new()), ..Self::default() }
    }

    fn take(&mut self, message: &Disturbance) {
        let states = self.changes.len();
        let t = seconds(message);
        if self.kept.take(message.head.stamp_ns) && self.kept.begins_again() {
            *self = Self { kept: std::mem::take(&mut self.kept), ..Self::new(states) };
        }
        let values = message.dx.iter().take(states).copied();
        self.changes.iter_mut().zip(values.clone()).for_each(|(changes, value)| changes.take(value));
        if let Some(rows) = &mut self.rows {
            rows.truncate(rows.partition_point(|row| row.0 < t));
            rows.push((t, values.collect()));
            if rows.len() > MOST_DISTURBANCES {
                self.rows = None;
            }
        }
    }
}

impl Survey {
    /// Reads a run's log.
    pub fn of(log: &Log, vehicle: &Vehicle, layout: &Layout, period_s: f64) -> Result<Self, ReadError> {
        let mut reading = Reading {
            layout,
            kept: Default::default(),
            health: Vec::new(),
            tracked: vec![false; layout.outputs()],
            steps: vec![SetpointSteps::new(); layout.outputs()],
            disturbances: Disturbances::new(layout.states),
            claimed: Vec::new(),
            charge: ChargeSteps::default(),
            findings: Vec::new(),
            converged_s: None,
        };
        let mut messages = log.bench_messages()?;
        for message in messages.by_ref() {
            reading.take(&message?);
        }
        // Truth, estimate and command: the steps of the loop.
        let end_s = reading.kept[1..4].iter().map(|kept| kept.last_ns() as f64 * NS).fold(0.0, f64::max);
        let onsets = Onsets::new(&derivatives(vehicle), &reading.disturbances.changes, period_s, end_s);
        let onsets = reading.disturbances.onsets(log, onsets)?;
        let mut survey = Self {
            kept: reading.kept,
            health: reading.health,
            end_s,
            onsets,
            tracked: reading.tracked,
            claimed: reading.claimed,
            charge: reading.charge,
            findings: reading.findings,
            holes: messages.holes(),
            steps: reading.steps.into_iter().map(SetpointSteps::finish).collect(),
            period_s,
        };
        let judged_until = survey.first_onset_s();
        if judged_until < end_s && reading.converged_s.is_none_or(|t| t >= judged_until) {
            survey.claimed = survey.claimed_before(log, judged_until)?;
        }
        Ok(survey)
    }

    /// Time of the first disturbance, s; infinite without one.
    pub fn first_onset_s(&self) -> f64 {
        self.onsets.first().map_or(f64::INFINITY, |onset| onset.at_s)
    }

    /// Topics of the loop with the time of their last message, s, for those that have one.
    pub fn ends(&self) -> Vec<(&'static str, f64)> {
        let there = LOOP.iter().filter(|(topic, _)| self.has(*topic));
        there.map(|(topic, name)| (*name, self.kept[*topic].last_ns() as f64 * NS)).collect()
    }

    /// Whether the log has a valid message of the topic with this index.
    pub fn has(&self, topic: usize) -> bool {
        self.kept[topic].messages() > 0
    }

    /// The topics' messages once more.
    pub fn again(&self) -> [Again<'_>; TOPICS] {
        self.kept.each_ref().map(Kept::again)
    }

    /// The parts that are evaluated of each output, in the order of their starts.
    pub fn parts(&self) -> Vec<Vec<Part>> {
        parts(&self.steps, &self.onsets, self.period_s, self.end_s)
    }

    /// The standard deviations that the estimator claims last before `until_s`, s.
    fn claimed_before(&self, log: &Log, until_s: f64) -> Result<Vec<f64>, ReadError> {
        let mut again = self.again();
        let mut claimed = Vec::new();
        for message in log.bench_messages()? {
            if let BenchMessage::Estimate(estimate) = message?
                && again[2].counts(estimate.head.stamp_ns)
            {
                if seconds(&estimate) >= until_s {
                    break;
                }
                claimed = estimate.std.to_vec();
            }
        }
        Ok(claimed)
    }
}

impl Reading<'_> {
    fn take(&mut self, message: &BenchMessage) {
        match message {
            BenchMessage::Health(report) => self.take_health(*report),
            BenchMessage::Disturbance(message) => self.disturbances.take(message),
            BenchMessage::Setpoint(setpoint) => self.take_setpoint(setpoint),
            BenchMessage::Estimate(estimate) => self.take_estimate(estimate),
            BenchMessage::Sent(sent) => self.charge.take_sent(sent),
            BenchMessage::Autopilot(told) => self.charge.take_autopilot(told),
            BenchMessage::Finding(finding) => self.take_finding(finding),
            _ => {}
        }
        if let Some((topic, ns)) = place(message) {
            self.kept[topic].take(ns);
        }
    }

    fn take_health(&mut self, report: Health) {
        NodeHealth::take(&mut self.health, report);
    }

    fn take_finding(&mut self, finding: &Finding) {
        let text = finding_text(finding, &self.layout.output_names(), self.layout.shown_units());
        if let Some(text) = text.filter(|_| self.findings.len() < MOST_LISTED) {
            self.findings.push(FindingEvent { at_s: seconds(finding), number: finding.number, text });
        }
    }

    fn take_setpoint(&mut self, setpoint: &Setpoint) {
        let t = seconds(setpoint);
        let outputs = self.layout.wanted(setpoint).into_iter().zip(&mut self.steps).zip(&mut self.tracked);
        for ((wanted, steps), tracked) in outputs {
            steps.take(t, wanted);
            *tracked |= wanted.is_finite();
        }
    }

    fn take_estimate(&mut self, estimate: &Estimate) {
        let t = seconds(estimate);
        // A restarted estimator has not converged yet.
        self.converged_s = self.converged_s.filter(|converged| *converged < t);
        if estimate.flags & flags::CONVERGED != 0 {
            self.converged_s.get_or_insert(t);
        }
        self.claimed.clear();
        self.claimed.extend_from_slice(&estimate.std);
    }
}

impl Disturbances {
    /// Finds the onsets. The log is read again where it has too many messages to store.
    fn onsets(self, log: &Log, mut onsets: Onsets) -> Result<Vec<DisturbanceEvent>, ReadError> {
        match self.rows {
            Some(rows) => rows.iter().for_each(|(t, values)| onsets.take(*t, values)),
            None => {
                let mut again = self.kept.again();
                for message in log.bench_messages()? {
                    if let BenchMessage::Disturbance(message) = message?
                        && again.counts(message.head.stamp_ns)
                    {
                        onsets.take(seconds(&message), &message.dx);
                    }
                }
            }
        }
        Ok(onsets.finish())
    }
}

/// Names of the states, and the units of their derivatives.
pub(crate) fn derivatives(vehicle: &Vehicle) -> Vec<(String, ShownUnit)> {
    vehicle.states.iter().map(|state| (state.name.clone(), state.unit.shown().per_second())).collect()
}

/// The parts that are evaluated of each output, from the steps of its setpoint and the onsets of
/// disturbances.
pub(crate) fn parts(
    steps: &[Vec<(f64, f64)>],
    onsets: &[DisturbanceEvent],
    period_s: f64,
    end_s: f64,
) -> Vec<Vec<Part>> {
    let onsets: Vec<f64> = onsets.iter().map(|event| event.at_s).collect();
    // A step of any setpoint moves the other outputs as well: a helicopter rolls to go sideways.
    let mut moves: Vec<f64> = steps.iter().flatten().map(|step| step.0).collect();
    moves.sort_unstable_by(f64::total_cmp);
    steps
        .iter()
        .map(|steps| {
            let times: Vec<f64> = steps.iter().map(|step| step.0).collect();
            let steps = steps.iter().map(|&(at, to)| {
                let until = later(at, &times).min(later(at, &onsets)).min(end_s);
                (at, Part::Step { at, until, to })
            });
            let disturbances = onsets.iter().map(|&at| {
                let until = recovery_end(at, &onsets, &moves, period_s, end_s);
                (at, Part::Disturbance { at, until })
            });
            let mut parts: Vec<(f64, Part)> = steps.chain(disturbances).collect();
            parts.sort_by(|a, b| a.0.total_cmp(&b.0));
            parts.into_iter().map(|(_, part)| part).collect()
        })
        .collect()
}

/// The first of ascending `times` after `at`; infinite without one.
fn later(at: f64, times: &[f64]) -> f64 {
    times.get(times.partition_point(|t| *t <= at + 1e-9)).copied().unwrap_or(f64::INFINITY)
}

/// End of the evaluated recovery from a disturbance at `at`: the next onset, the last sample before the next step
/// of a setpoint (the sample of the step already has the new one), or the end of the run.
fn recovery_end(at: f64, onsets: &[f64], steps: &[f64], period_s: f64, end: f64) -> f64 {
    later(at, onsets).min(later(at, steps) - 0.5 * period_s).min(end)
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
