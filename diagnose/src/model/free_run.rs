//! Free runs: simulations of a vehicle, with any effects added, over a record's inputs.

use std::sync::{Arc, Mutex, PoisonError};

use whirlstand_vehicle::{Effect, Rows, Simulator, Subsystem, Vehicle};

use crate::Watch;
use crate::data::record::{Channel, Data};
use crate::model::commands::Commands;
use crate::model::observer::Observer;
use crate::model::optimum::ModelError;
use crate::model::part::Part;
use crate::model::place::Place;
use crate::model::reach::Reach;
use crate::thresholds::DIVERGED_RATIO;

/// A vehicle that is simulated over one record.
#[derive(Debug, Clone)]
pub struct FreeRun<'d> {
    /// The record.
    pub data: &'d Data,
    /// The vehicle, with all effects that are taken as known.
    pub vehicle: Vehicle,
    /// Largest magnitude that a run may reach, per channel.
    reach: Vec<f64>,
    /// Filter that corrects the run by the record itself; `None` for a free run.
    observer: Option<Arc<Observer>>,
    /// True where the vehicle has no decoupled parts.
    coupled: bool,
    /// Decoupled parts of the vehicle that fits have asked for.
    parts: Arc<Mutex<Vec<Arc<Part>>>>,
    /// Whoever waits for the fits over these runs, and may end them.
    watch: Option<&'d Watch>,
}

impl<'d> FreeRun<'d> {
    /// Prepares a vehicle and a record for simulation.
    pub fn new(vehicle: &Vehicle, data: &'d Data) -> Self {
        let mut vehicle = vehicle.clone();
        // A simulation does not need the file's text, and copies of a vehicle are made by the hundred.
        vehicle.source_text.clear();
        let peak =
            |values: &[f64]| values.iter().filter(|v| v.is_finite()).fold(0.0f64, |m, v| m.max(v.abs()));
        let reach = |channel: &Channel| DIVERGED_RATIO * peak(&channel.values).max(f64::MIN_POSITIVE);
        let observer = data
            .memory_s
            .and_then(|memory_s| Observer::new(&vehicle, data, &vec![memory_s; vehicle.states.len()]));
        Self {
            data,
            reach: data.channels.iter().map(reach).collect(),
            observer: observer.map(Arc::new),
            coupled: Reach::new(&vehicle, data, vehicle.free.iter().map(|free| &free.target)).is_coupled(),
            vehicle,
            parts: Arc::default(),
            watch: None,
        }
    }

    /// The same of a record that is followed, by a filter with a memory of its own for each state, s; `None` where it cannot
    /// follow the record.
    pub fn following(self, memory_s: &[f64]) -> Option<Self> {
        let observer = Observer::new(&self.vehicle, self.data, memory_s)?;
        Some(Self { observer: Some(Arc::new(observer)), ..self })
    }

    /// True where the vehicle has no decoupled parts.
    pub fn is_coupled(&self) -> bool {
        self.coupled
    }

    /// A decoupled part of the vehicle with its part of the record, made once.
    pub fn part(&self, subsystem: &Subsystem) -> Arc<Part> {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = parts.iter().find(|part| part.subsystem == *subsystem) {
            return Arc::clone(known);
        }
        let observer = self.observer.as_deref();
        let part = Arc::new(Part::new(subsystem.clone(), &self.vehicle, self.data, observer));
        parts.push(Arc::clone(&part));
        part
    }

    /// Free runs of a part of the vehicle.
    pub fn of_part<'p>(&self, part: &'p Part) -> FreeRun<'p>
    where
        'd: 'p,
    {
        FreeRun {
            data: &part.data,
            vehicle: part.vehicle.clone(),
            reach: part.channels.iter().map(|c| self.reach[*c]).collect(),
            observer: part.observer.clone(),
            coupled: true,
            parts: Arc::default(),
            watch: self.watch,
        }
    }

    /// The same; a fit over these runs ends early, after whole steps, when the watch is stopped.
    pub fn watched(self, watch: &'d Watch) -> Self {
        Self { watch: Some(watch), ..self }
    }

    /// Whether fits over these runs are to end.
    pub fn is_stopped(&self) -> bool {
        self.watch.is_some_and(Watch::is_stopped)
    }

    /// The vehicle with effects added.
    ///
    /// # Errors
    /// [`ModelError::Inapplicable`] when one does not fit.
    pub fn with(&self, effects: &[Effect]) -> Result<Vehicle, ModelError> {
        let mut vehicle = self.vehicle.clone();
        for effect in effects {
            vehicle.add_effect(effect.clone()).map_err(|_| ModelError::Inapplicable)?;
        }
        Ok(vehicle)
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.vehicle.states.len()
    }

    /// Number of initial state values of all records.
    pub fn initials(&self) -> usize {
        self.states() * self.data.starts.len()
    }

    /// Simulates a vehicle over all records, each from its own initial state: the one loop of all free runs.
    /// At every step `prepare` is called with the simulator before the inputs are applied, and `observe`
    /// after that; an `observe` that returns false ends the run as diverged.
    fn fly(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        mut prepare: impl FnMut(usize, &mut Simulator),
        mut observe: impl FnMut(usize, &[f64]) -> bool,
    ) -> Result<(), ModelError> {
        let data = self.data;
        if data.memory_s.is_some() && self.observer.is_none() {
            return Err(ModelError::Diverged);
        }
        let at_rest = data.simulator(vehicle).ok_or(ModelError::Diverged)?;
        let mut simulator = data.begin(&at_rest, 0);
        let (mut errors, mut change) = (vec![0.0; data.channels.len()], vec![0.0; self.states()]);
        let mut records = data.starts.iter().zip(initial.chunks_exact(self.states().max(1))).peekable();
        for (k, u) in data.inputs.chunks_exact(data.m).enumerate() {
            if let Some((_, state)) = records.next_if(|(start, _)| **start == k) {
                if simulator.diverged() {
                    return Err(ModelError::Diverged);
                }
                if k > 0 {
                    simulator = data.begin(&at_rest, k);
                }
                simulator.set_state(state);
            }
            prepare(k, &mut simulator);
            simulator.apply(u);
            let y = simulator.measure();
            if !observe(k, y) {
                return Err(ModelError::Diverged);
            }
            if let Some(observer) = &self.observer {
                self.errors(k, y, &mut errors);
                observer.change(k, &errors, &mut change);
                simulator.correct(&change);
            }
            simulator.advance();
        }
        if simulator.diverged() { Err(ModelError::Diverged) } else { Ok(()) }
    }

    /// Prediction errors of all channels at a step, 0 where there is no sample.
    fn errors(&self, step: usize, y: &[f64], errors: &mut [f64]) {
        for (channel, error) in self.data.channels.iter().zip(errors) {
            *error = channel.measured_at(step).map_or(0.0, |measured| measured - y[channel.output]);
        }
    }

    /// Predicted samples of all channels with `effects` added, from the initial state.
    ///
    /// # Errors
    /// When an effect does not fit, or the run diverges.
    pub fn run(&self, effects: &[Effect], initial: &[f64]) -> Result<Vec<f64>, ModelError> {
        self.run_vehicle(&self.with(effects)?, initial)
    }

    /// Predicted samples as [`FreeRun::run`], for a vehicle that already has its effects.
    ///
    /// # Errors
    /// When the run diverges.
    pub fn run_vehicle(&self, vehicle: &Vehicle, initial: &[f64]) -> Result<Vec<f64>, ModelError> {
        self.sampled_in_blocks(vehicle, initial, None)
    }

    /// Predicted samples with an additional force on one state: `scale` times one value per step, in the unit
    /// of the state's derivative.
    ///
    /// # Errors
    /// When the run diverges.
    pub fn run_forced(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        state: usize,
        (scale, force): (f64, &[f64]),
    ) -> Result<Vec<f64>, ModelError> {
        if self.data.memory_s.is_none() {
            let force: Vec<f64> = force.iter().map(|f| scale * f).collect();
            return self.sampled_in_blocks(vehicle, initial, Some((state, &force)));
        }
        let mut derivative = vec![0.0; vehicle.states.len()];
        self.sampled(vehicle, initial, |k, simulator| {
            derivative[state] = scale * force[k];
            simulator.disturb(&derivative);
        })
    }

    fn places(&self) -> Vec<Place> {
        let data = self.data;
        let channels = data.channels.iter().zip(data.ranges()).zip(&self.reach);
        let place = |((c, range), reach): ((&Channel, std::ops::Range<usize>), &f64)| {
            let (next, at, end) = (c.first, range.start, range.end);
            Place { output: c.output, stride: c.stride, next, at, end, reach: *reach }
        };
        channels.map(place).collect()
    }

    /// Simulates as [`FreeRun::fly`] where nothing happens between two steps but the observer's correction: many steps
    /// at once. `hear` is called with the first step of a block and its rows. A force is for runs without an observer.
    fn fly_in_blocks(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        force: Option<(usize, &[f64])>,
        mut hear: impl FnMut(usize, &Rows) -> Result<(), ModelError>,
    ) -> Result<(), ModelError> {
        let data = self.data;
        if data.memory_s.is_some() && self.observer.is_none() {
            return Err(ModelError::Diverged);
        }
        let (mut errors, mut change) = (vec![0.0; data.channels.len()], vec![0.0; self.states()]);
        let mut known: Option<Rows> = None;
        let ends = data.starts.iter().copied().skip(1).chain([data.steps]);
        let n = self.states();
        let at_rest = data.simulator(vehicle).ok_or(ModelError::Diverged)?;
        for (record, (start, end)) in data.starts.iter().copied().zip(ends).enumerate() {
            let mut simulator = data.begin(&at_rest, start);
            simulator.set_state(&initial[record * n..(record + 1) * n]);
            let rows = known.get_or_insert_with(|| simulator.rows());
            for (block, inputs) in
                data.inputs[start * data.m..end * data.m].chunks(Rows::MOST * data.m).enumerate()
            {
                let first = start + block * Rows::MOST;
                match &self.observer {
                    None => {
                        let force = force.map(|(state, force)| (state, &force[first..]));
                        simulator.run_forced_block(inputs, force, rows);
                    }
                    Some(observer) => {
                        let mut correct = |row: usize, y: &[f64], x: &mut [f64]| {
                            self.errors(first + row, y, &mut errors);
                            observer.change(first + row, &errors, &mut change);
                            x.iter_mut().zip(&change).for_each(|(x, change)| *x += change);
                        };
                        simulator.run_corrected_block(inputs, &mut correct, rows);
                    }
                }
                hear(first, rows)?;
            }
            if simulator.diverged() {
                return Err(ModelError::Diverged);
            }
        }
        Ok(())
    }

    fn sampled(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        prepare: impl FnMut(usize, &mut Simulator),
    ) -> Result<Vec<f64>, ModelError> {
        let mut samples = vec![0.0; self.data.samples()];
        let mut places = self.places();
        self.fly(vehicle, initial, prepare, |k, y| {
            places.iter_mut().all(|place| place.take(k, |output| &y[output..=output], &mut samples))
        })?;
        Ok(samples)
    }

    fn sampled_in_blocks(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        force: Option<(usize, &[f64])>,
    ) -> Result<Vec<f64>, ModelError> {
        let mut samples = vec![0.0; self.data.samples()];
        let mut places = self.places();
        self.fly_in_blocks(vehicle, initial, force, |k, rows| {
            let taken =
                places.iter_mut().all(|place| place.take(k, |output| rows.output(output), &mut samples));
            if taken { Ok(()) } else { Err(ModelError::Diverged) }
        })?;
        Ok(samples)
    }

    /// States over the steps of all records, one vector per state, SI.
    ///
    /// # Errors
    /// When the run diverges.
    pub fn run_states(&self, vehicle: &Vehicle, initial: &[f64]) -> Result<Vec<Vec<f64>>, ModelError> {
        let mut states = vec![Vec::with_capacity(self.data.steps); self.states()];
        self.fly_in_blocks(vehicle, initial, None, |_, rows| {
            let columns = states.iter_mut().enumerate();
            columns.for_each(|(i, column)| column.extend_from_slice(rows.state(i)));
            Ok(())
        })?;
        Ok(states)
    }

    /// Predictions of all samples over a horizon of `horizon` steps: each starts from the state that the
    /// record shows up to its start, and starts are a quarter of the horizon apart, so that a sample is
    /// predicted over at least three quarters of it. Before the first horizon has passed they start from the
    /// initial state.
    ///
    /// # Errors
    /// When a run diverges.
    pub fn ahead(
        &self,
        vehicle: &Vehicle,
        initial: &[f64],
        horizon: usize,
        commands: Commands,
    ) -> Result<Vec<f64>, ModelError> {
        let data = self.data;
        let every = (horizon / 4).max(1);
        let mut samples = vec![f64::NAN; data.samples()];
        let ranges = data.ranges();
        let mut since = 0;
        let prepare = |k: usize, simulator: &mut Simulator| {
            let first = data.starts.contains(&k);
            if first {
                since = k;
            }
            if !(k - since).is_multiple_of(every) {
                return;
            }
            let mut runner = simulator.clone();
            let predicted_from = if first { k } else { k + horizon - every };
            let end = data.starts.iter().copied().find(|s| *s > k).unwrap_or(data.steps).min(k + horizon);
            for j in k..end {
                runner.apply(data.commands(commands.step(j, k, since)));
                let y = runner.measure();
                for (channel, range) in data.channels.iter().zip(&ranges).filter(|_| j >= predicted_from) {
                    let sample = channel.sample_at(j).map(|sample| range.start + sample);
                    if let Some(at) = sample.filter(|at| *at < range.end) {
                        samples[at] = y[channel.output];
                    }
                }
                runner.advance();
            }
        };
        self.fly(vehicle, initial, prepare, |_, _| true)?;
        Ok(samples)
    }

    /// Largest magnitude of each input over the record.
    pub fn input_peaks(&self) -> Vec<f64> {
        (0..self.data.m).map(|j| self.data.input(j).fold(0.0f64, |m, u| m.max(u.abs()))).collect()
    }
}
