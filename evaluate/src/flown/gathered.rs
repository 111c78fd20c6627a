//! The stored steps of K flights side by side, and the figures of each flight.

use multiversion::multiversion;
use whirlstand_msgs::{MAX_STATES, Setpoint, flags};
use whirlstand_vehicle::Vehicle;

use super::step::{FlownStep, NodeCounts};
use crate::layout::{Layout, NS};
use crate::metrics::{Changes, Claim, Consistency, ConsistencySum, DisturbanceEvent, EffortSum};
use crate::metrics::{NodeTiming, Onsets, SetpointSteps, Timing};
use crate::output::{ErrorSum, OutputSum};
use crate::summary::{MOST_LISTED, RunSummary};
use crate::survey::{derivatives, parts};

/// K flights, step by step. Data common to all flights are stored once.
#[derive(Debug, Clone)]
pub(super) struct Gathered<const K: usize> {
    layout: Layout,
    period_s: f64,
    t: Vec<f64>,
    /// Output by output, of every step.
    outputs: Vec<Vec<[f64; K]>>,
    wanted: Vec<Vec<f64>>,
    errors: Vec<ErrorSum<K>>,
    inputs: Vec<EffortSum<K>>,
    setpoints: Setpoints,
    disturbed: Vec<Disturbed>,
    /// The disturbances of the last step.
    disturbance: Vec<[f64; K]>,
    nis: Vec<[f64; K]>,
    dof: Vec<u32>,
    converged_s: Option<f64>,
    converged: Vec<bool>,
    std: Vec<f64>,
    held: [u64; K],
    /// Steps in failsafe, and those of them at the end.
    failsafe: [[u64; 2]; K],
}

/// Setpoints of the outputs.
#[derive(Debug, Clone)]
struct Setpoints {
    /// The last setpoint, with its mask of tracked states.
    last: Option<([f64; MAX_STATES], u64)>,
    asked: Vec<f64>,
    steps: Vec<SetpointSteps>,
    tracked: Vec<bool>,
}

/// Times at which the disturbance of a flight changes, and the values from then on, row by row.
#[derive(Debug, Clone, Default)]
struct Disturbed {
    t: Vec<f64>,
    rows: Vec<f64>,
}

impl Setpoints {
    fn take(&mut self, t: f64, setpoint: &Setpoint, layout: &Layout) {
        // A repeated setpoint is no step of the setpoint.
        if self.last.as_ref().is_some_and(|(x, tracked)| (x, tracked) == (&setpoint.x, &setpoint.tracked)) {
            return;
        }
        self.last = Some((setpoint.x, setpoint.tracked));
        self.asked = layout.wanted(setpoint);
        for ((wanted, steps), tracked) in self.asked.iter().zip(&mut self.steps).zip(&mut self.tracked) {
            steps.take(t, *wanted);
            *tracked |= wanted.is_finite();
        }
    }
}

impl<const K: usize> Gathered<K> {
    /// Before the first of about `steps` steps of `vehicle`.
    pub fn new(vehicle: &Vehicle, period_s: f64, steps: usize) -> Self {
        let layout = Layout::new(vehicle);
        let (n, p) = (layout.states, layout.outputs());
        Self {
            period_s,
            t: Vec::with_capacity(steps),
            outputs: vec![Vec::with_capacity(steps); p],
            wanted: vec![Vec::with_capacity(steps); p],
            errors: vec![ErrorSum::new(); p],
            inputs: vehicle.inputs.iter().map(|input| EffortSum::new(input.lower, input.upper)).collect(),
            setpoints: Setpoints {
                last: None,
                asked: vec![f64::NAN; p],
                steps: vec![SetpointSteps::new(); p],
                tracked: vec![false; p],
            },
            disturbed: vec![Disturbed::default(); K],
            disturbance: Vec::with_capacity(n),
            nis: Vec::with_capacity(steps),
            dof: Vec::with_capacity(steps),
            converged_s: None,
            converged: Vec::with_capacity(steps),
            std: Vec::with_capacity(steps * n),
            held: [0; K],
            failsafe: [[0; 2]; K],
            layout,
        }
    }

    /// Takes the next step.
    pub fn take(&mut self, step: &FlownStep<'_, K>) {
        let t = step.stamp_ns as f64 * NS;
        self.t.push(t);
        self.setpoints.take(t, step.setpoint, &self.layout);
        self.wanted.iter_mut().zip(&self.setpoints.asked).for_each(|(row, wanted)| row.push(*wanted));
        sum(self, t, step);
        self.take_disturbance(t, step.disturbance);
        if step.converged {
            self.converged_s.get_or_insert(t);
        }
        self.nis.push(*step.nis);
        self.dof.push(step.dof);
        self.converged.push(step.converged);
        self.std.extend_from_slice(&step.std[..self.layout.states]);
        for ((held, [all, at_end]), seen) in self.held.iter_mut().zip(&mut self.failsafe).zip(step.flags) {
            *held += u64::from(seen & flags::HELD != 0);
            let failsafe = u64::from(seen & flags::FAILSAFE != 0);
            (*all, *at_end) = (*all + failsafe, (*at_end + 1) * failsafe);
        }
    }

    /// Stores a disturbance when it changes, as the plant publishes it.
    fn take_disturbance(&mut self, t: f64, rows: &[[f64; K]]) {
        let rows = &rows[..self.layout.states];
        if self.t.len() > 1 && self.disturbance == rows {
            return;
        }
        for (l, flight) in self.disturbed.iter_mut().enumerate() {
            let changes = || self.disturbance.iter().zip(rows).any(|(old, new)| old[l] != new[l]);
            if self.t.len() == 1 || changes() {
                flight.t.push(t);
                flight.rows.extend(rows.iter().map(|row| row[l]));
            }
        }
        self.disturbance.clear();
        self.disturbance.extend_from_slice(rows);
    }

    /// The figures of flight `l` of `vehicle` as `name`.
    pub fn summary(
        &self,
        l: usize,
        (vehicle, name, seed): (&Vehicle, &str, u64),
        counts: &NodeCounts,
    ) -> RunSummary {
        let end_s = self.t.last().copied().unwrap_or(0.0);
        let mut disturbances = self.onsets(l, vehicle, end_s);
        let first_s = disturbances.first().map_or(f64::INFINITY, |onset| onset.at_s);
        let steps: Vec<_> = self.setpoints.steps.iter().cloned().map(SetpointSteps::finish).collect();
        let parts = parts(&steps, &disturbances, self.period_s, end_s);
        let mut y = Vec::with_capacity(self.t.len());
        let outputs = vehicle.outputs.iter().enumerate().map(|(i, output)| {
            let unit = output.unit.shown();
            let mut sum = OutputSum::new(unit, "truth", self.setpoints.tracked[i], output.noise, Vec::new());
            y.clear();
            y.extend(self.outputs[i].iter().map(|row| row[l]));
            sum.take_record(self.errors[i].lane(l), (&self.t, &y, &self.wanted[i]), &parts[i]);
            (output.name.clone(), sum.finish())
        });
        let inputs = vehicle.inputs.iter().zip(&self.inputs);
        let inputs = inputs.map(|(i, sum)| (i.name.clone(), sum.finish(l, self.period_s, i.unit.shown())));
        let (outputs, estimator) = (outputs.collect(), self.consistency(l, first_s, end_s));
        disturbances.truncate(MOST_LISTED);
        RunSummary {
            name: name.into(),
            vehicle: vehicle.name.clone(),
            mode: "lockstep".into(),
            transport: "inproc".into(),
            seed,
            period_s: self.period_s,
            duration_s: end_s,
            log: String::new(),
            disturbances,
            findings: Vec::new(),
            outputs,
            inputs: inputs.collect(),
            estimator,
            timing: self.timing(l, counts),
        }
    }

    fn onsets(&self, l: usize, vehicle: &Vehicle, end_s: f64) -> Vec<DisturbanceEvent> {
        let n = self.layout.states;
        let flight = &self.disturbed[l];
        let rows = || flight.t.iter().zip(flight.rows.chunks_exact(n.max(1)));
        let mut changes = vec![Changes::default(); n];
        for (_, row) in rows() {
            changes.iter_mut().zip(row).for_each(|(changes, value)| changes.take(*value));
        }
        let mut onsets = Onsets::new(&derivatives(vehicle), &changes, self.period_s, end_s);
        rows().for_each(|(t, row)| onsets.take(*t, row));
        onsets.finish()
    }

    fn consistency(&self, l: usize, until_s: f64, end_s: f64) -> Option<Consistency> {
        let n = self.layout.states;
        let unconverged = until_s < end_s && self.converged_s.is_none_or(|t| t >= until_s);
        let last = match unconverged {
            true => self.t.partition_point(|t| *t < until_s),
            false => self.t.len(),
        };
        let claimed = &self.std[last.saturating_sub(1) * n..last * n];
        let mut sum = ConsistencySum::new(n, until_s, claimed);
        let steps = self.t.iter().zip(&self.nis).zip(&self.dof).zip(&self.converged);
        for ((((t, nis), dof), converged), std) in steps.zip(self.std.chunks_exact(n.max(1))) {
            sum.take_claim(&Claim { t: *t, nis: nis[l], dof: *dof, converged: *converged }, std);
        }
        sum.finish([])
    }

    fn timing(&self, l: usize, counts: &NodeCounts) -> Timing {
        let steps = self.t.len() as u64;
        let node = |(name, rejected): (&str, u64)| {
            let deadline_misses = if name == "plant" { counts.misses } else { 0 };
            let timing = NodeTiming { steps, deadline_misses, lost: 0, rejected, restarts: 0, latency: None };
            (name.to_string(), timing)
        };
        let nodes = ["plant", "estimator", "controller"].into_iter().zip(counts.rejected).map(node);
        let mut timing = Timing {
            deadline_misses: counts.misses,
            held_steps: self.held[l],
            nodes: nodes.collect(),
            ..Timing::default()
        };
        timing.witness_failsafe(self.failsafe[l][0], self.failsafe[l][1], steps);
        timing
    }
}

/// Outputs, integrals of their errors, and the effort of the inputs.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn sum<const K: usize>(flights: &mut Gathered<K>, t: f64, step: &FlownStep<'_, K>) {
    let Gathered { layout, outputs, errors, inputs, setpoints, .. } = flights;
    for (i, (outputs, error)) in outputs.iter_mut().zip(errors).enumerate() {
        let y = layout.output_lanes(i, step.x, step.u);
        error.take(t, &y, setpoints.asked[i]);
        outputs.push(y);
    }
    inputs.iter_mut().zip(step.u).for_each(|(sum, u)| sum.take(u));
}
