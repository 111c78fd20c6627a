//! The figures of a flight that was simulated in this process, without a log, to the last bit those that its log would give.
//!
//! Its steps are held, some hundred bytes each, because what is to be judged of a step is known only when the flight is over.

use whirlstand_msgs::{Setpoint, flags};
use whirlstand_vehicle::Vehicle;

use crate::layout::{Layout, NS};
use crate::metrics::{Changes, Claim, ConsistencySum, EffortSum, NodeTiming, Onsets, SetpointSteps, Timing};
use crate::output::OutputSum;
use crate::summary::{MOST_LISTED, RunSummary};
use crate::survey::{derivatives, parts};

/// One step of a flight, SI.
pub struct FlownStep<'a> {
    /// Bench time, ns.
    pub stamp_ns: u64,
    /// The true states.
    pub x: &'a [f64],
    /// The inputs in force.
    pub u: &'a [f64],
    /// Flags of `Truth`.
    pub flags: u32,
    /// What disturbs the derivative of each state.
    pub disturbance: &'a [f64],
    /// What the law was asked for.
    pub setpoint: &'a Setpoint,
    /// The filter's normalised innovation squared, and its degrees of freedom.
    pub innovation: (f64, u32),
    /// The standard deviations that the filter claims.
    pub std: &'a [f64],
    /// Whether the filter says that it has converged.
    pub converged: bool,
}

/// What the nodes of the flight counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct NodeCounts {
    /// Steps without a usable command.
    pub misses: u64,
    /// What plant, estimator and controller refused.
    pub rejected: [u64; 3],
}

/// A flight, step by step.
#[derive(Debug, Clone)]
pub struct Flown {
    layout: Layout,
    period_s: f64,
    t: Vec<f64>,
    /// Output by output, of every step.
    outputs: Vec<Vec<f64>>,
    wanted: Vec<Vec<f64>>,
    inputs: Vec<EffortSum>,
    steps: Vec<SetpointSteps>,
    tracked: Vec<bool>,
    /// The last setpoint, and what it asks of each output.
    setpoint: Option<([f64; whirlstand_msgs::MAX_STATES], u64)>,
    asked: Vec<f64>,
    /// Times of the disturbances' changes, and the values from then on, row after row.
    changed: Vec<f64>,
    disturbances: Vec<f64>,
    claims: Vec<Claim>,
    std: Vec<f64>,
    held: u64,
    failsafe: [u64; 2],
}

impl Flown {
    /// Before the first of about `steps` steps of `vehicle`.
    pub fn new(vehicle: &Vehicle, period_s: f64, steps: usize) -> Self {
        let layout = Layout::new(vehicle);
        let (n, p) = (layout.states, layout.outputs());
        let rows = || vec![Vec::with_capacity(steps); p];
        Self {
            period_s,
            t: Vec::with_capacity(steps),
            outputs: rows(),
            wanted: rows(),
            inputs: vehicle.inputs.iter().map(|input| EffortSum::new(input.lower, input.upper)).collect(),
            steps: vec![SetpointSteps::new(); p],
            tracked: vec![false; p],
            setpoint: None,
            asked: vec![f64::NAN; p],
            changed: Vec::new(),
            disturbances: Vec::new(),
            claims: Vec::with_capacity(steps),
            std: Vec::with_capacity(steps * n),
            held: 0,
            failsafe: [0; 2],
            layout,
        }
    }

    /// Takes the next step.
    pub fn take(&mut self, step: &FlownStep<'_>) {
        let t = step.stamp_ns as f64 * NS;
        self.t.push(t);
        self.take_setpoint(t, step.setpoint);
        for (i, y) in self.outputs.iter_mut().enumerate() {
            y.push(self.layout.output(i, step.x, step.u));
        }
        self.wanted.iter_mut().zip(&self.asked).for_each(|(row, wanted)| row.push(*wanted));
        self.inputs.iter_mut().zip(step.u).for_each(|(sum, u)| sum.take(*u));
        let n = self.layout.states;
        // As the plant publishes it: when it changes.
        let last = self.disturbances.len().saturating_sub(n);
        if self.changed.is_empty() || self.disturbances[last..] != *step.disturbance {
            self.changed.push(t);
            self.disturbances.extend_from_slice(&step.disturbance[..n]);
        }
        let (nis, dof) = step.innovation;
        self.claims.push(Claim { t, nis, dof, converged: step.converged });
        self.std.extend_from_slice(&step.std[..n]);
        self.held += u64::from(step.flags & flags::HELD != 0);
        let failsafe = u64::from(step.flags & flags::FAILSAFE != 0);
        self.failsafe = [self.failsafe[0] + failsafe, (self.failsafe[1] + 1) * failsafe];
    }

    fn take_setpoint(&mut self, t: f64, setpoint: &Setpoint) {
        // What is wanted again changes no step of the setpoint.
        if self.setpoint != Some((setpoint.x, setpoint.tracked)) {
            self.setpoint = Some((setpoint.x, setpoint.tracked));
            self.asked = self.layout.wanted(setpoint);
            for ((wanted, steps), tracked) in self.asked.iter().zip(&mut self.steps).zip(&mut self.tracked) {
                steps.take(t, *wanted);
                *tracked |= wanted.is_finite();
            }
        }
    }

    /// The figures of the flight of `vehicle` as `name`; the consistency of the filter without the errors of the states.
    pub fn summary(self, vehicle: &Vehicle, name: &str, seed: u64, counts: &NodeCounts) -> RunSummary {
        let n = self.layout.states;
        let end_s = self.t.last().copied().unwrap_or(0.0);
        let rows = || self.changed.iter().zip(self.disturbances.chunks_exact(n.max(1)));
        let mut changes = vec![Changes::default(); n];
        for (_, row) in rows() {
            changes.iter_mut().zip(row).for_each(|(changes, value)| changes.take(*value));
        }
        let mut onsets = Onsets::new(&derivatives(vehicle), &changes, self.period_s, end_s);
        rows().for_each(|(t, row)| onsets.take(*t, row));
        let mut disturbances = onsets.finish();
        let first_s = disturbances.first().map_or(f64::INFINITY, |onset| onset.at_s);
        let steps: Vec<_> = self.steps.iter().cloned().map(SetpointSteps::finish).collect();
        let parts = parts(&steps, &disturbances, self.period_s, end_s);
        let signals = self.outputs.iter().zip(&self.wanted).zip(&self.tracked).zip(&parts);
        let outputs = vehicle.outputs.iter().zip(signals).map(|(output, (((y, wanted), tracked), parts))| {
            let mut sum =
                OutputSum::new(output.unit.si_symbol(), "truth", *tracked, output.noise, Vec::new());
            sum.take_record((&self.t, y, wanted), parts);
            (output.name.clone(), sum.finish())
        });
        let inputs = vehicle.inputs.iter().zip(&self.inputs);
        let inputs =
            inputs.map(|(i, sum)| (i.name.clone(), sum.finish(self.period_s, i.unit.si_symbol()))).collect();
        let (outputs, estimator) = (outputs.collect(), self.consistency(first_s, end_s));
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
            inputs,
            estimator,
            timing: self.timing(counts),
        }
    }

    fn consistency(&self, until_s: f64, end_s: f64) -> Option<crate::metrics::Consistency> {
        let n = self.layout.states;
        let converged_s = self.claims.iter().find(|claim| claim.converged).map(|claim| claim.t);
        let unconverged = until_s < end_s && converged_s.is_none_or(|t| t >= until_s);
        let last = match unconverged {
            true => self.claims.partition_point(|claim| claim.t < until_s),
            false => self.claims.len(),
        };
        let claimed = &self.std[last.saturating_sub(1) * n..last * n];
        let mut sum = ConsistencySum::new(n, until_s, claimed);
        for (claim, std) in self.claims.iter().zip(self.std.chunks_exact(n.max(1))) {
            sum.take_claim(claim, std);
        }
        sum.finish([])
    }

    fn timing(&self, counts: &NodeCounts) -> Timing {
        let steps = self.t.len() as u64;
        let node = |(name, rejected): (&str, u64)| {
            let deadline_misses = if name == "plant" { counts.misses } else { 0 };
            let timing = NodeTiming { steps, deadline_misses, lost: 0, rejected, restarts: 0, latency: None };
            (name.to_string(), timing)
        };
        let nodes = ["plant", "estimator", "controller"].into_iter().zip(counts.rejected).map(node);
        let mut timing = Timing {
            deadline_misses: counts.misses,
            held_steps: self.held,
            nodes: nodes.collect(),
            ..Timing::default()
        };
        timing.witness_failsafe(self.failsafe[0], self.failsafe[1], steps);
        timing
    }
}
