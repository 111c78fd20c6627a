//! Location of a vehicle's signals in the messages of its bench.

use whirlstand_logs::SensorField;
use whirlstand_logs::bench_log::wanted;
use whirlstand_msgs::units::ShownSignals;
use whirlstand_msgs::{Message, Setpoint};
use whirlstand_vehicle::Vehicle;

/// ns to s.
pub(crate) const NS: f64 = 1e-9;

/// Bench time of a message, s.
pub(crate) fn seconds<M: Message>(message: &M) -> f64 {
    message.head().stamp_ns as f64 * NS
}

/// An output as a sum of states, and of inputs where the vehicle has feedthrough: indices and factors.
#[derive(Debug, Clone)]
struct Combination {
    states: Vec<(usize, f64)>,
    inputs: Vec<(usize, f64)>,
}

/// Location of the signals of a vehicle.
#[derive(Debug, Clone)]
pub(crate) struct Layout {
    /// Number of states.
    pub states: usize,
    /// Number of inputs.
    pub inputs: usize,
    outputs: Vec<Combination>,
    names: Vec<String>,
    units: ShownSignals,
    sensors: Vec<Option<SensorField>>,
}

impl Layout {
    pub fn new(vehicle: &Vehicle) -> Self {
        let terms =
            |row: Vec<f64>| row.into_iter().enumerate().filter(|(_, factor)| *factor != 0.0).collect();
        let row = |i: usize| Combination {
            states: terms(vehicle.c.row(i).iter().copied().collect()),
            inputs: terms(vehicle.d.row(i).iter().copied().collect()),
        };
        Self {
            states: vehicle.states.len(),
            inputs: vehicle.inputs.len(),
            outputs: (0..vehicle.outputs.len()).map(row).collect(),
            names: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
            units: vehicle.shown_units(),
            sensors: vehicle
                .outputs
                .iter()
                .enumerate()
                .map(|(i, output)| SensorField::of(&output.name, i))
                .collect(),
        }
    }

    /// Names of the outputs.
    pub fn output_names(&self) -> Vec<&str> {
        self.names.iter().map(String::as_str).collect()
    }

    /// The units in which values of the signals are shown.
    pub fn shown_units(&self) -> &ShownSignals {
        &self.units
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.outputs.len()
    }

    /// Output `i` for states `x` and inputs `u`; with empty `u`, from the states alone.
    pub fn output(&self, i: usize, x: &[f64], u: &[f64]) -> f64 {
        let [y] = self.output_lanes(i, x.as_chunks().0, u.as_chunks().0);
        y
    }

    /// Output `i` of K flights side by side.
    #[inline(always)]
    pub fn output_lanes<const K: usize>(&self, i: usize, x: &[[f64; K]], u: &[[f64; K]]) -> [f64; K] {
        let sum = |terms: &[(usize, f64)], values: &[[f64; K]]| {
            let mut sum = [0.0; K];
            for (values, factor) in terms.iter().filter_map(|(at, factor)| Some((values.get(*at)?, factor))) {
                sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += factor * value);
            }
            sum
        };
        let combination = &self.outputs[i];
        let (mut y, of_inputs) = (sum(&combination.states, x), sum(&combination.inputs, u));
        y.iter_mut().zip(of_inputs).for_each(|(y, u)| *y += u);
        y
    }

    /// The reference of every output that follows from a setpoint; NaN where one of its states is not
    /// tracked.
    pub fn wanted(&self, setpoint: &Setpoint) -> Vec<f64> {
        let states = wanted(setpoint);
        (0..self.outputs()).map(|i| self.output(i, &states, &[])).collect()
    }

    /// The fresh values in a sensor's message: index of the output and value.
    pub fn measured<M: Message>(&self, message: &M) -> impl Iterator<Item = (usize, f64)> {
        self.sensors.iter().enumerate().filter_map(|(i, field)| {
            let field = field.filter(|field| field.topic == M::TOPIC)?;
            Some((i, field.read(message))).filter(|(_, value)| !value.is_nan())
        })
    }
}
