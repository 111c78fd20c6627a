//! The figures of a flight that was simulated in this process, without a log: the same as `run` tells of its log.

use whirlstand_vehicle::Vehicle;

use crate::layout::Layout;
use crate::metrics::{Changes, EffortSum, Onsets, SetpointSteps, Timing};
use crate::output::OutputSum;
use crate::summary::RunSummary;
use crate::survey::{derivatives, parts};

/// A flight, step by step; SI, row after row.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Flight {
    /// Period, s.
    pub period_s: f64,
    /// The states, steps x states.
    pub states: Vec<f64>,
    /// The inputs in force, steps x inputs.
    pub inputs: Vec<f64>,
    /// What is wanted of each state, steps x states; NaN where nothing is.
    pub wanted: Vec<f64>,
    /// What disturbs the derivative of each state, steps x states.
    pub disturbance: Vec<f64>,
}

impl Flight {
    /// Number of steps.
    pub fn steps(&self, vehicle: &Vehicle) -> usize {
        self.states.len() / vehicle.states.len().max(1)
    }

    /// The figures of the flight of `vehicle`, judged by its true motion.
    pub fn summary(&self, vehicle: &Vehicle, name: &str, seed: u64) -> RunSummary {
        let (n, m) = (vehicle.states.len(), vehicle.inputs.len());
        let layout = Layout::new(vehicle);
        let time = |k: usize| k as f64 * self.period_s;
        let end_s = time(self.steps(vehicle).saturating_sub(1));
        let row = |values: &'_ [f64], k: usize, width: usize| values[k * width..(k + 1) * width].to_vec();
        let mut steps = vec![SetpointSteps::new(); layout.outputs()];
        let mut changes = vec![Changes::default(); n];
        let wanted_of = |k: usize| -> Vec<f64> {
            let states = row(&self.wanted, k, n);
            (0..layout.outputs()).map(|i| layout.output(i, &states, &[])).collect()
        };
        // As the plant publishes it: when it changes.
        let changed = |k: usize| k == 0 || row(&self.disturbance, k, n) != row(&self.disturbance, k - 1, n);
        for k in 0..self.steps(vehicle) {
            steps.iter_mut().zip(wanted_of(k)).for_each(|(steps, wanted)| steps.take(time(k), wanted));
            if changed(k) {
                changes.iter_mut().zip(row(&self.disturbance, k, n)).for_each(|(c, v)| c.take(v));
            }
        }
        let mut onsets = Onsets::new(&derivatives(vehicle), &changes, self.period_s, end_s);
        for k in (0..self.steps(vehicle)).filter(|k| changed(*k)) {
            onsets.take(time(k), &row(&self.disturbance, k, n));
        }
        let disturbances = onsets.finish();
        let steps: Vec<_> = steps.into_iter().map(SetpointSteps::finish).collect();
        let parts = parts(&steps, &disturbances, self.period_s, end_s);
        let mut outputs: Vec<OutputSum> = vehicle
            .outputs
            .iter()
            .zip(parts)
            .zip(&steps)
            .map(|((o, parts), steps)| {
                OutputSum::new(o.unit.si_symbol(), "truth", !steps.is_empty(), o.noise, parts)
            })
            .collect();
        let mut inputs: Vec<EffortSum> =
            vehicle.inputs.iter().map(|input| EffortSum::new(input.lower, input.upper)).collect();
        for k in 0..self.steps(vehicle) {
            let (x, u) = (row(&self.states, k, n), row(&self.inputs, k, m));
            for (i, (sum, wanted)) in outputs.iter_mut().zip(wanted_of(k)).enumerate() {
                sum.take(time(k), layout.output(i, &x, &u), wanted);
            }
            inputs.iter_mut().zip(u).for_each(|(sum, u)| sum.take(u));
        }
        let named = vehicle.inputs.iter().zip(&inputs);
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
            outputs: vehicle
                .outputs
                .iter()
                .zip(outputs)
                .map(|(o, sum)| (o.name.clone(), sum.finish()))
                .collect(),
            inputs: named
                .map(|(i, sum)| (i.name.clone(), sum.finish(self.period_s, i.unit.si_symbol())))
                .collect(),
            estimator: None,
            timing: Timing::default(),
        }
    }
}
