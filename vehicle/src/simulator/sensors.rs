//! All sensors: from the motion to the reported values.

use super::combinations::Combinations;
use super::compile::Row;
use super::disturbances::consumer;
use super::divergence::held;
use super::rows::{BLOCK, Rows};
use super::sensor::{Sensor, declared, phase};
use super::switch::Switch;
use crate::effects::{Effect, Kind, Place};
use crate::model::{Engine, Vehicle};
use crate::random::Stream;

/// Sensor settings that depend on the combination of switched effects.
#[derive(Debug, Clone)]
struct Chosen {
    rows: (Row, Row),
    tap: Option<usize>,
}

/// All sensors of a vehicle.
#[derive(Debug, Clone)]
pub struct Sensors {
    period_s: f64,
    pub(super) sensors: Vec<Sensor>,
    /// Distinct frequencies of declared vibrations, Hz, with sine and cosine of their phase at the current
    /// step.
    pub(super) frequencies: Vec<(f64, f64, f64)>,
    /// True when a sensor has a delay.
    pub(super) delayed: bool,
    /// True for expected values.
    expected: bool,
    /// Misaligned pairs of outputs: indices, cosine, sine.
    pub(super) turned: Vec<(usize, usize, f64, f64, Switch)>,
    /// Settings of each combination of switched effects, and the index of the current one, whose rows are
    /// stored with the sensors.
    combinations: Vec<Vec<Chosen>>,
    combination: usize,
    motion: Vec<f64>,
    values: Vec<f64>,
    fresh: Vec<bool>,
    /// Step of `values`.
    measured: Option<u64>,
}

impl Sensors {
    /// `seed` is `None` for expected values: no randomness, no rounding, every output fresh at every step.
    pub fn new(
        vehicle: &Vehicle,
        combinations: &Combinations,
        effects: &[(Effect, Place)],
        period_s: f64,
        seed: Option<u64>,
    ) -> Self {
        let mut frequencies: Vec<(f64, f64, f64)> = Vec::new();
        let rows = vehicle.outputs.iter().zip(&combinations.all[0].system.outputs);
        let mut sensors: Vec<Sensor> =
            rows.map(|(output, rows)| declared(output, rows, &mut frequencies, seed)).collect();
        let mut turned = Vec::new();
        for (index, (effect, place)) in effects.iter().enumerate() {
            match *place {
                Place::OutputPair(i, j) => {
                    let (sine, cosine) = libm::sincos(effect.get("angle_rad"));
                    let pairs = vehicle.turned_outputs(i, j).into_iter().flatten();
                    turned.extend(pairs.map(|(i, j)| (i, j, cosine, sine, Switch::new(index, effect))));
                }
                Place::Output(i) => {
                    let stream = seed.map(|seed| Stream::new(seed, &consumer(effects, index)));
                    sensors[i].add(effect, Switch::new(index, effect), stream);
                }
                _ => {}
            }
        }
        let mut chosen: Vec<Vec<Chosen>> = vec![Vec::new(); combinations.all.len()];
        for (i, sensor) in sensors.iter_mut().enumerate() {
            let delays_s = combinations.delays_s(effects, Kind::SensorDelay, Place::Output(i));
            let rows = combinations.rows(i);
            for ((all, delay_s), rows) in chosen.iter_mut().zip(delays_s).zip(rows) {
                all.push(Chosen { rows, tap: sensor.keep(delay_s, period_s) });
            }
            sensor.tap = chosen[0][i].tap;
        }
        let p = sensors.len();
        for sensor in &mut sensors {
            sensor.plain = sensor.is_plain();
        }
        Self {
            period_s,
            delayed: sensors.iter().any(|s| !s.taps.is_empty()),
            expected: seed.is_none(),
            sensors,
            frequencies,
            turned,
            combinations: chosen,
            combination: 0,
            motion: vec![0.0; p],
            values: vec![0.0; p],
            fresh: vec![false; p],
            measured: None,
        }
    }

    /// Offsets inside every step at which a delayed output must be sampled.
    pub fn cuts_s(&self) -> impl Iterator<Item = f64> + '_ {
        self.sensors.iter().flat_map(|s| &s.taps).map(|tap| tap.offset_s).filter(|o| *o > 0.0)
    }

    /// True for expected values: no randomness, and every output fresh at every step.
    pub fn are_expected(&self) -> bool {
        self.expected
    }

    pub fn has_delay(&self) -> bool {
        self.delayed
    }

    /// Selects the settings of a combination of switched effects.
    pub fn choose(&mut self, combination: usize) {
        let before = std::mem::replace(&mut self.combination, combination);
        if before == combination {
            return;
        }
        for (i, sensor) in self.sensors.iter_mut().enumerate() {
            for (index, is_new) in [(before, false), (combination, true)] {
                let chosen = &mut self.combinations[index][i];
                std::mem::swap(&mut sensor.ideal, &mut chosen.rows.0);
                std::mem::swap(&mut sensor.lagged, &mut chosen.rows.1);
                sensor.tap = if is_new { chosen.tap } else { sensor.tap };
            }
        }
    }

    /// Sets all past values to the current outputs.
    pub fn fill_past(&mut self, z: &[f64], v: &[f64]) {
        for sensor in &mut self.sensors {
            let value = sensor.lagged.value(z, v);
            sensor.taps.iter_mut().for_each(|tap| tap.fill(value));
        }
        self.measured = None;
    }

    /// Stores the values of delayed outputs at this offset of a step, within which a state may have diverged: the
    /// states are held at the step's end only.
    #[inline]
    pub fn remember(&mut self, offset_s: f64, z: &[f64], v: &[f64]) {
        if self.delayed {
            self.push(offset_s, z, v);
        }
    }

    fn push(&mut self, offset_s: f64, z: &[f64], v: &[f64]) {
        let tolerance = 2.0 * super::inputs::TIME_TOLERANCE * self.period_s;
        for sensor in &mut self.sensors {
            for tap in sensor.taps.iter_mut().filter(|tap| (tap.offset_s - offset_s).abs() <= tolerance) {
                tap.push(held(sensor.lagged.value(z, v)));
            }
        }
    }

    /// Outputs without sensor errors.
    pub fn ideal(&self, z: &[f64], v: &[f64], out: &mut [f64]) {
        for (value, sensor) in out.iter_mut().zip(&self.sensors) {
            *value = sensor.ideal.value(z, v);
        }
    }

    /// Measures at a step; a second call at the same step changes nothing.
    pub fn measure(&mut self, step: u64, engine: Engine, z: &[f64], v: &[f64]) -> &[f64] {
        if self.measured == Some(step) {
            return &self.values;
        }
        self.measured = Some(step);
        for (motion, sensor) in self.motion.iter_mut().zip(&self.sensors) {
            *motion = sensor.late().unwrap_or_else(|| sensor.lagged.value(z, v));
        }
        let t = step as f64 * self.period_s;
        for (i, j, cosine, sine, switch) in &self.turned {
            if !switch.is_on(t) {
                continue;
            }
            let (i, j) = (*i, *j);
            let (first, second) = (self.motion[i], self.motion[j]);
            self.motion[i] = cosine * first + sine * second;
            self.motion[j] = cosine * second - sine * first;
        }
        if engine != Engine::Off {
            for (frequency_hz, sine, cosine) in &mut self.frequencies {
                (*sine, *cosine) = phase(*frequency_hz, t);
            }
        }
        for (index, sensor) in self.sensors.iter_mut().enumerate() {
            // The first measurement is fresh at any step; later ones are at multiples of the divider.
            self.fresh[index] = step >= sensor.due;
            if self.fresh[index] {
                sensor.due =
                    if sensor.every == 1 { step + 1 } else { (step / sensor.every + 1) * sensor.every };
                self.values[index] = if sensor.plain && engine == Engine::Off {
                    sensor.gain * self.motion[index] + sensor.offset + sensor.drift * t
                } else {
                    sensor.value(self.motion[index], t, engine, &self.frequencies)
                };
            }
        }
        &self.values
    }

    /// Writes the delayed outputs of a step to the rows of a block.
    #[inline]
    pub fn recall(&self, rows: &mut Rows, row: usize) {
        if self.delayed {
            for (index, sensor) in self.sensors.iter().enumerate() {
                if let Some(late) = sensor.late() {
                    rows.outputs[index * BLOCK + row] = late;
                }
            }
        }
    }

    /// Measures all steps of a block that begins at `step`, in which delayed outputs are already written.
    /// Equivalent to [`Sensors::measure`] one by one, with the engine off and every output fresh.
    #[inline(always)]
    pub fn measure_block(&mut self, step: u64, rows: &mut Rows) {
        let Rows { length, states, inputs, outputs, .. } = rows;
        for (sensor, motion) in self.sensors.iter().zip(outputs.chunks_exact_mut(BLOCK)) {
            if sensor.tap.is_none() {
                sensor.lagged.values(BLOCK, states, inputs, &mut motion[..*length]);
            }
        }
        let t = |row: usize| (step + row as u64) as f64 * self.period_s;
        for (i, j, cosine, sine, switch) in &self.turned {
            let (i, j) = (*i, *j);
            for row in (0..*length).filter(|row| switch.is_on(t(*row))) {
                let (first, second) = (outputs[i * BLOCK + row], outputs[j * BLOCK + row]);
                outputs[i * BLOCK + row] = cosine * first + sine * second;
                outputs[j * BLOCK + row] = cosine * second - sine * first;
            }
        }
        for (sensor, values) in self.sensors.iter_mut().zip(outputs.chunks_exact_mut(BLOCK)) {
            let rows = values[..*length].iter_mut().enumerate();
            if sensor.plain {
                let (gain, offset, drift) = (sensor.gain, sensor.offset, sensor.drift);
                rows.for_each(|(row, y)| *y = gain * *y + offset + drift * t(row));
            } else {
                rows.for_each(|(row, y)| *y = sensor.value(*y, t(row), Engine::Off, &self.frequencies));
            }
        }
    }

    /// Switches an effect on a sensor; true if it exists.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        // A misalignment turns up to two pairs.
        let turned =
            self.turned.iter_mut().filter_map(|(.., switch)| switch.set(effect, on).then_some(())).count();
        turned > 0 || self.sensors.iter_mut().any(|sensor| sensor.switch(effect, on))
    }

    pub fn fresh(&self) -> &[bool] {
        &self.fresh
    }
}
