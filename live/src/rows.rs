//! Joins messages into rows: a row for every step, a column for every line of the page.

use std::collections::VecDeque;

use serde::Serialize;
use whirlstand_logs::{BenchMessage, SensorField};
use whirlstand_msgs::{Estimate, Message};
use whirlstand_vehicle::{Engine, Vehicle};

use crate::chi_square::ChiSquareBand;
use crate::scene::Scene;

/// Most rows that may wait for further messages of their step: twice the length of a bus queue.
const MOST_WAITING: usize = 2048;

/// Half the width of a band that holds 95 % of a normal distribution, in standard deviations.
const NORMAL_95: f64 = 1.96;

/// Outputs whose bias [`Estimate`] contains, in its order.
const BIASES: [&str; 4] = ["roll", "pitch", "roll_rate", "pitch_rate"];

/// Suffixes of column names: the quantity of a signal. The page uses the same names.
mod column {
    pub const MEASURED: &str = "y";
    pub const ESTIMATED: &str = "e";
    pub const SIMULATED: &str = "s";
    pub const WANTED: &str = "w";
    pub const RESIDUAL: &str = "r";
    pub const BAND: &str = "b";
    pub const COMMAND: &str = "u";
    pub const APPLIED: &str = "a";
    pub const NIS: &str = "nis";
    pub const NIS_LOW: &str = "nis_low";
    pub const NIS_HIGH: &str = "nis_high";
}

/// Columns of an output, in their order in a row.
const OF_OUTPUT: [&str; 6] =
    [column::MEASURED, column::ESTIMATED, column::SIMULATED, column::WANTED, column::RESIDUAL, column::BAND];
const OF_INPUT: [&str; 2] = [column::COMMAND, column::APPLIED];

struct Row {
    step: u64,
    /// Values of the columns; NaN where unknown.
    values: Vec<f32>,
}

/// Rows as they are sent, column by column.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub(crate) struct Block {
    pub step: Vec<u64>,
    /// Values column by column in the order of [`Rows::columns`]; a missing value is `null`.
    pub values: Vec<Vec<f32>>,
    /// Average number of steps per row.
    pub thinned: f64,
}

/// The rows of a bench that have not been sent yet.
pub(crate) struct Rows {
    vehicle: Vehicle,
    /// Factors of outputs and inputs from SI to the unit that is shown.
    factors: (Vec<f64>, Vec<f64>),
    /// Index of the state with the same name as each output.
    wanted: Vec<Option<usize>>,
    fields: Vec<Option<SensorField>>,
    biases: [Option<usize>; BIASES.len()],
    nis: ChiSquareBand,
    /// Variance of the noise of each sensor, SI.
    noise: Vec<f64>,
    rows: VecDeque<Row>,
    columns: usize,
    /// The last step that was sent.
    sent: Option<u64>,
}

impl Rows {
    pub fn new(scene: &Scene, vehicle: &Vehicle) -> Self {
        let (outputs, inputs) = (vehicle.outputs.len(), vehicle.inputs.len());
        let factors = |signals: &[crate::scene::Signal]| signals.iter().map(|s| s.factor).collect::<Vec<_>>();
        Self {
            factors: (factors(&scene.outputs), factors(&scene.inputs)),
            wanted: vehicle.outputs.iter().map(|o| vehicle.state_index(&o.name)).collect(),
            fields: vehicle.outputs.iter().enumerate().map(|(i, o)| SensorField::of(&o.name, i)).collect(),
            biases: BIASES.map(|name| vehicle.output_index(name)),
            nis: ChiSquareBand::new(outputs),
            noise: variances(vehicle, Engine::default()),
            rows: VecDeque::new(),
            columns: OF_OUTPUT.len() * outputs + OF_INPUT.len() * inputs + 3,
            sent: None,
            vehicle: vehicle.clone(),
        }
    }

    /// Names of the columns, in order.
    pub fn columns(scene: &Scene) -> Vec<String> {
        let named = |kinds: &[&str], name: &str| {
            kinds.iter().map(|kind| format!("{kind}.{name}")).collect::<Vec<_>>()
        };
        let outputs = scene.outputs.iter().flat_map(|o| named(&OF_OUTPUT, &o.name));
        let inputs = scene.inputs.iter().flat_map(|i| named(&OF_INPUT, &i.name));
        let nis = [column::NIS, column::NIS_LOW, column::NIS_HIGH].map(String::from);
        outputs.chain(inputs).chain(nis).collect()
    }

    /// Takes in a message; a message of a step that has been sent is ignored.
    pub fn hear(&mut self, heard: &BenchMessage) {
        match heard {
            BenchMessage::Imu(m) => self.measured(m),
            BenchMessage::Odometry(m) => self.measured(m),
            BenchMessage::Outputs(m) => self.measured(m),
            BenchMessage::Estimate(m) => self.estimated(m),
            BenchMessage::Truth(m) => {
                let outputs = self.outputs_of(&m.x, &m.u);
                let applied: Vec<_> = m.u.iter().zip(&self.factors.1).map(|(u, f)| u * f).collect();
                let (output, input) = (self.output(2), self.input(1));
                let Some(row) = self.row(m.head.step) else { return };
                outputs.into_iter().enumerate().for_each(|(i, y)| row[output(i)] = y as f32);
                applied.into_iter().enumerate().for_each(|(i, u)| row[input(i)] = u as f32);
            }
            BenchMessage::Command(m) => {
                let command: Vec<_> = m.u.iter().zip(&self.factors.1).map(|(u, f)| u * f).collect();
                let input = self.input(0);
                let Some(row) = self.row(m.head.step).filter(|_| m.count > 0) else { return };
                command.into_iter().enumerate().for_each(|(i, u)| row[input(i)] = u as f32);
            }
            BenchMessage::Setpoint(m) => {
                let tracked = |state: usize| m.tracked >> state & 1 == 1;
                let wanted: Vec<_> = self.wanted.iter().zip(&self.factors.0).collect();
                let wanted = wanted.into_iter().map(|(state, factor)| {
                    let state = state.filter(|state| tracked(*state))?;
                    Some((m.x[state] * factor) as f32)
                });
                let wanted: Vec<_> = wanted.collect();
                let output = self.output(3);
                let Some(row) = self.row(m.head.step) else { return };
                let wanted = wanted.into_iter().enumerate();
                wanted.for_each(|(i, w)| row[output(i)] = w.unwrap_or(f32::NAN));
            }
            BenchMessage::Disturbance(_)
            | BenchMessage::Sent(_)
            | BenchMessage::Reported(_)
            | BenchMessage::Autopilot(_)
            | BenchMessage::Finding(_)
            | BenchMessage::Adjustment(_)
            | BenchMessage::Health(_) => {}
        }
    }

    /// Sets the engine state, on which the vibration of the sensors depends.
    pub fn set_engine(&mut self, engine: Engine) {
        self.noise = variances(&self.vehicle, engine);
    }

    /// The newest step.
    pub fn newest(&self) -> Option<u64> {
        self.rows.back().map(|row| row.step).or(self.sent)
    }

    /// Discards all rows, because the plant began a new run.
    pub fn clear(&mut self) {
        self.rows.clear();
        self.sent = None;
    }

    /// Takes the rows up to a step, thinned to at most `most` rows.
    pub fn take(&mut self, until: u64, most: usize) -> Block {
        let ready = self.rows.partition_point(|row| row.step <= until);
        let mut rows: Vec<Row> = self.rows.drain(..ready).collect();
        rows.iter_mut().for_each(|row| self.residuals(&mut row.values));
        self.sent = rows.last().map(|row| row.step).or(self.sent);
        let group = rows.len().div_ceil(most.max(1)).max(1);
        let kept: Vec<Row> = rows.chunks_mut(group).map(merged).collect();
        let column = |i: usize| kept.iter().map(|row| row.values[i]).collect();
        Block {
            step: kept.iter().map(|row| row.step).collect(),
            values: (0..self.columns).map(column).collect(),
            thinned: rows_per_kept(ready, kept.len()),
        }
    }

    fn output(&self, kind: usize) -> impl Fn(usize) -> usize + use<> {
        move |i| OF_OUTPUT.len() * i + kind
    }

    fn input(&self, kind: usize) -> impl Fn(usize) -> usize + use<> {
        let first = OF_OUTPUT.len() * self.vehicle.outputs.len();
        move |i| first + OF_INPUT.len() * i + kind
    }

    fn row(&mut self, step: u64) -> Option<&mut [f32]> {
        if self.sent.is_some_and(|sent| step <= sent) {
            return None;
        }
        let at = self.rows.partition_point(|row| row.step < step);
        if self.rows.get(at).is_none_or(|row| row.step != step) {
            if self.rows.len() >= MOST_WAITING {
                return None;
            }
            self.rows.insert(at, Row { step, values: vec![f32::NAN; self.columns] });
        }
        self.rows.get_mut(at).map(|row| row.values.as_mut_slice())
    }

    /// C x + D u in the units that are shown.
    fn outputs_of(&self, x: &[f64], u: &[f64]) -> Vec<f64> {
        let v = &self.vehicle;
        let one = |i: usize| -> f64 {
            let of_x: f64 = (0..v.states.len()).map(|j| v.c[(i, j)] * x[j]).sum();
            let of_u: f64 = (0..v.inputs.len()).map(|j| v.d[(i, j)] * u[j]).sum();
            self.factors.0[i] * (of_x + of_u)
        };
        (0..v.outputs.len()).map(one).collect()
    }

    fn measured<M: Message>(&mut self, message: &M) {
        let values: Vec<_> = self
            .fields
            .iter()
            .zip(&self.factors.0)
            .map(|(field, factor)| {
                let field = field.as_ref().filter(|field| field.topic == M::TOPIC)?;
                Some((field.read(message) * factor) as f32)
            })
            .collect();
        let output = self.output(0);
        let Some(row) = self.row(message.head().step) else { return };
        let values = values.into_iter().enumerate().filter_map(|(i, v)| Some((i, v?)));
        values.for_each(|(i, value)| row[output(i)] = value);
    }

    fn estimated(&mut self, m: &Estimate) {
        let mut estimated = self.outputs_of(&m.x, &[0.0; whirlstand_msgs::MAX_INPUTS]);
        for (bias, output) in m.bias.iter().zip(self.biases) {
            if let Some(i) = output {
                estimated[i] += self.factors.0[i] * bias;
            }
        }
        let v = &self.vehicle;
        let variance =
            |i: usize| -> f64 { (0..v.states.len()).map(|j| (v.c[(i, j)] * m.std[j]).powi(2)).sum::<f64>() };
        // Variance of a measurement's residual after the filter's update: R - C P C', computed from the Kalman
        // gain.
        let band = |i: usize| {
            let left = self.noise[i] - variance(i);
            if left > 0.0 { NORMAL_95 * left.sqrt() * self.factors.0[i] } else { f64::NAN }
        };
        let bands: Vec<_> = (0..v.outputs.len()).map(band).collect();
        let (low, high) = self.nis.of(m.dof);
        let nis = if m.dof > 0 { m.nis / f64::from(m.dof) } else { f64::NAN };
        let (estimate, width, last) = (self.output(1), self.output(5), self.columns - 3);
        let Some(row) = self.row(m.head.step) else { return };
        estimated.into_iter().enumerate().for_each(|(i, y)| row[estimate(i)] = y as f32);
        bands.into_iter().enumerate().for_each(|(i, b)| row[width(i)] = b as f32);
        row[last..].copy_from_slice(&[nis as f32, low as f32, high as f32]);
    }

    fn residuals(&self, values: &mut [f32]) {
        for output in values[..OF_OUTPUT.len() * self.vehicle.outputs.len()].chunks_mut(OF_OUTPUT.len()) {
            output[4] = output[0] - output[1];
        }
    }
}

fn variances(vehicle: &Vehicle, engine: Engine) -> Vec<f64> {
    vehicle.outputs.iter().map(|output| output.sensor_std(engine, 0.0).powi(2)).collect()
}

/// Merges several rows into one: the last value of each column.
fn merged(rows: &mut [Row]) -> Row {
    let Some((last, before)) = rows.split_last_mut() else { return Row { step: 0, values: Vec::new() } };
    for (i, value) in last.values.iter_mut().enumerate().filter(|(_, value)| value.is_nan()) {
        let known = before.iter().rev().map(|row| row.values[i]).find(|v| !v.is_nan());
        *value = known.unwrap_or(f32::NAN);
    }
    Row { step: last.step, values: std::mem::take(&mut last.values) }
}

fn rows_per_kept(rows: usize, kept: usize) -> f64 {
    if kept == 0 { 1.0 } else { rows as f64 / kept as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Controls;
    use whirlstand_msgs::{Head, Imu, Setpoint, Truth, valid};

    fn scene() -> (Scene, Vehicle) {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        (Scene::new("lab", "", 5_000_000, &vehicle, Controls::Nothing), vehicle)
    }

    fn head(step: u64) -> Head {
        Head { seq: step, step, stamp_ns: step * 5_000_000 }
    }

    #[test]
    fn the_messages_of_a_step_stand_in_one_row_in_the_units_that_are_shown() {
        let (scene, vehicle) = scene();
        let mut rows = Rows::new(&scene, &vehicle);
        let column = |name: &str| Rows::columns(&scene).iter().position(|c| c == name).unwrap();
        let roll = vehicle.state_index("roll").unwrap();
        let mut truth = Truth { head: head(3), ..Truth::zeroed() };
        truth.x[roll] = 0.1;
        truth.u[0] = 0.5;
        let mut setpoint = Setpoint { head: head(3), tracked: 1 << roll, ..Setpoint::zeroed() };
        setpoint.x[roll] = 0.2;
        let mut estimate = Estimate { head: head(3), nis: 8.0, dof: 4, ..Estimate::zeroed() };
        estimate.x[roll] = 0.05;
        rows.hear(&BenchMessage::Imu(Imu {
            head: head(3),
            roll: 0.15,
            valid: valid::FIRST,
            ..Imu::zeroed()
        }));
        rows.hear(&BenchMessage::Truth(truth));
        rows.hear(&BenchMessage::Setpoint(setpoint));
        rows.hear(&BenchMessage::Estimate(estimate));
        let block = rows.take(3, 10);
        assert_eq!(block.step, [3]);
        let at = |name: &str| block.values[column(name)][0];
        for (name, radians) in
            [("y.roll", 0.15f64), ("s.roll", 0.1), ("e.roll", 0.05), ("w.roll", 0.2), ("r.roll", 0.1)]
        {
            assert!((f64::from(at(name)) - radians.to_degrees()).abs() < 1e-4, "{name}: {}", at(name));
        }
        assert!(at("y.roll_rate").is_nan(), "it was not fresh");
        let declared = vehicle.outputs[vehicle.output_index("roll").unwrap()].sensor_std(Engine::Flying, 0.0);
        assert!(
            (f64::from(at("b.roll")) - (NORMAL_95 * declared).to_degrees()).abs() < 1e-4,
            "{}",
            at("b.roll")
        );
        assert_eq!((at("a.u_roll"), at("nis")), (0.5, 2.0));
        assert!(at("nis_low") < 1.0 && at("nis_high") > 1.0);
    }

    #[test]
    fn what_is_sent_is_not_sent_again_and_a_fast_bench_is_thinned() {
        let (scene, vehicle) = scene();
        let mut rows = Rows::new(&scene, &vehicle);
        for step in 0..100 {
            rows.hear(&BenchMessage::Truth(Truth { head: head(step), ..Truth::zeroed() }));
        }
        let block = rows.take(79, 20);
        assert_eq!((block.step.len(), block.step[0], block.step[19], block.thinned), (20, 3, 79, 4.0));
        rows.hear(&BenchMessage::Truth(Truth { head: head(60), ..Truth::zeroed() }));
        assert_eq!(rows.take(99, 100).step, (80..100).collect::<Vec<_>>());
        for step in 0..100_000 {
            rows.hear(&BenchMessage::Truth(Truth { head: head(1000 + step), ..Truth::zeroed() }));
        }
        assert_eq!(rows.rows.len(), MOST_WAITING, "what nobody takes does not pile up");
    }
}
