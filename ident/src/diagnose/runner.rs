//! Free runs of a vehicle over a record's inputs, with any effects added.

use whirlstand_vehicle::{Effect, Vehicle};

use super::data::Data;

/// A run that leaves the largest measured value this many times behind is given up: nonlinear effects far out cost
/// thousands of steps each.
const FAR_OUT: f64 = 1e3;
/// By how much a state is moved for a sensitivity.
const NUDGE: f64 = 1e-3;

/// Where the samples of a channel go.
struct Place {
    output: usize,
    stride: usize,
    /// Step of the next sample.
    next: usize,
    /// Where it goes, and where the channel ends.
    at: usize,
    end: usize,
    /// Largest magnitude.
    reach: f64,
}

/// A vehicle that is run over one record.
#[derive(Debug, Clone)]
pub struct Runner<'d> {
    /// The record.
    pub data: &'d Data,
    /// The vehicle, with whatever is taken for granted.
    pub vehicle: Vehicle,
    /// Largest magnitude that a run may reach, channel by channel.
    reach: Vec<f64>,
}

impl<'d> Runner<'d> {
    /// For a vehicle and a record.
    pub fn new(vehicle: &Vehicle, data: &'d Data) -> Self {
        let mut vehicle = vehicle.clone();
        // Texts are of no use to a simulation, and copies of a vehicle are made by the hundred.
        vehicle.source_text.clear();
        let peak =
            |values: &[f64]| values.iter().filter(|v| v.is_finite()).fold(0.0f64, |m, v| m.max(v.abs()));
        let reach = data.channels.iter().map(|c| FAR_OUT * peak(&c.values).max(f64::MIN_POSITIVE)).collect();
        Self { data, vehicle, reach }
    }

    /// The vehicle with effects added; `None` when one does not fit.
    pub fn with(&self, effects: &[Effect]) -> Option<Vehicle> {
        let mut vehicle = self.vehicle.clone();
        for effect in effects {
            vehicle.add_effect(effect.clone()).ok()?;
        }
        Some(vehicle)
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.vehicle.states.len()
    }

    /// How many numbers the initial states of all records are.
    pub fn initials(&self) -> usize {
        self.states() * self.data.starts.len()
    }

    /// Predicted samples of all channels with `effects` added, from the initial state; `None` when the run leaves all
    /// bounds.
    pub fn run(&self, effects: &[Effect], initial: &[f64]) -> Option<Vec<f64>> {
        self.run_vehicle(&self.with(effects)?, initial)
    }

    /// As [`Runner::run`] for a vehicle that is complete.
    pub fn run_vehicle(&self, vehicle: &Vehicle, initial: &[f64]) -> Option<Vec<f64>> {
        let data = self.data;
        let mut simulator = data.begin(vehicle, 0)?;
        let mut records = data.starts.iter().zip(initial.chunks_exact(self.states().max(1))).peekable();
        let mut bounded = true;
        let mut samples = vec![0.0; data.samples()];
        let mut places: Vec<Place> = data
            .channels
            .iter()
            .zip(data.ranges())
            .zip(&self.reach)
            .map(|((c, range), reach)| Place {
                output: c.output,
                stride: c.stride,
                next: c.first,
                at: range.start,
                end: range.end,
                reach: *reach,
            })
            .collect();
        for (k, u) in data.inputs.chunks_exact(data.m).enumerate() {
            if let Some((_, state)) = records.next_if(|(start, _)| **start == k) {
                bounded &= !simulator.diverged();
                if k > 0 {
                    simulator = data.begin(vehicle, k)?;
                }
                simulator.set_state(state);
            }
            simulator.apply(u);
            let y = simulator.measure();
            for place in &mut places {
                if k == place.next && place.at < place.end {
                    let y = y[place.output];
                    if y.abs() > place.reach {
                        return None;
                    }
                    samples[place.at] = y;
                    place.next += place.stride;
                    place.at += 1;
                }
            }
            simulator.advance();
        }
        (bounded && !simulator.diverged() && samples.iter().all(|y| y.is_finite())).then_some(samples)
    }

    /// States over the first record, one vector a state; `None` when the run leaves all bounds.
    pub fn run_states(&self, initial: &[f64]) -> Option<Vec<Vec<f64>>> {
        let mut simulator = self.data.begin(&self.vehicle, 0)?;
        simulator.set_state(&initial[..self.states()]);
        let mut states = vec![Vec::with_capacity(self.data.steps); self.states()];
        let until = self.data.starts.get(1).copied().unwrap_or(self.data.steps);
        for u in self.data.inputs.chunks_exact(self.data.m).take(until) {
            states.iter_mut().zip(simulator.state()).for_each(|(column, x)| column.push(*x));
            simulator.step(u);
        }
        (!simulator.diverged()).then_some(states)
    }

    /// Derivatives of all samples by the initial state, one column a state.
    pub fn initial_columns(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        centre: &[f64],
    ) -> Option<Vec<Vec<f64>>> {
        (0..self.initials())
            .map(|i| {
                let mut moved = initial.to_vec();
                moved[i] += NUDGE;
                let mut column = self.run_vehicle(vehicle, &moved)?;
                column.iter_mut().zip(centre).for_each(|(c, y)| *c = (*c - y) / NUDGE);
                Some(column)
            })
            .collect()
    }

    /// Largest magnitude of each input over the record.
    pub fn input_peaks(&self) -> Vec<f64> {
        (0..self.data.m).map(|j| self.data.input(j).fold(0.0f64, |m, u| m.max(u.abs()))).collect()
    }
}
