//! Records of simulated flights.

// Each of the programs that share it uses a part.
#![allow(dead_code)]

use std::f64::consts::TAU;

use whirlstand_logs::Record;
use whirlstand_vehicle::{Simulator, Vehicle};

/// A pilot-like input: three sines without a common period and a doublet.
pub fn stick(t: f64, j: usize) -> f64 {
    let f = 0.13 + 0.04 * j as f64;
    let doublet = if (4.0..5.0).contains(&t) {
        3.0
    } else if (5.0..6.0).contains(&t) {
        -3.0
    } else {
        0.0
    };
    2.0 * (TAU * f * t).sin() + (TAU * 3.7 * f * t + 1.0).sin() + 0.5 * (TAU * 9.1 * f * t).cos() + doublet
}

/// Flies `vehicle` open loop from `initial` with inputs of size `gain`; `seed` of `None` is without noise.
pub fn flight(vehicle: &Vehicle, length_s: f64, initial: &[f64], gain: f64, seed: Option<u64>) -> Record {
    pushed_flight(vehicle, length_s, initial, gain, seed, |x| vec![0.0; x.len()])
}

/// As [`flight`], with what `push` makes of the state added to its derivative.
pub fn pushed_flight(
    vehicle: &Vehicle,
    length_s: f64,
    initial: &[f64],
    gain: f64,
    seed: Option<u64>,
    push: impl Fn(&[f64]) -> Vec<f64>,
) -> Record {
    steered_flight(vehicle, length_s, initial, seed, |t, j| gain * stick(t, j), push)
}

/// A flight with the inputs that `steer` gives for a time, s, and the index of an input.
pub fn steered_flight(
    vehicle: &Vehicle,
    length_s: f64,
    initial: &[f64],
    seed: Option<u64>,
    steer: impl Fn(f64, usize) -> f64,
    push: impl Fn(&[f64]) -> Vec<f64>,
) -> Record {
    let period = 0.01;
    let mut simulator = match seed {
        Some(seed) => Simulator::new(vehicle, period, seed),
        None => Simulator::expected(vehicle, period),
    }
    .unwrap();
    simulator.set_state(initial);
    let steps = (length_s / period) as usize;
    let time: Vec<f64> = (0..steps).map(|k| k as f64 * period).collect();
    let mut inputs = vec![Vec::new(); vehicle.inputs.len()];
    let mut outputs = vec![Vec::new(); vehicle.outputs.len()];
    for t in &time {
        let u: Vec<f64> = (0..inputs.len()).map(|j| steer(*t, j)).collect();
        let force = push(simulator.state());
        simulator.disturb(&force);
        simulator.apply(&u);
        let y = simulator.measure();
        outputs.iter_mut().zip(y).for_each(|(column, y)| column.push(*y));
        inputs.iter_mut().zip(&u).for_each(|(column, u)| column.push(*u));
        simulator.advance();
    }
    let mut record = Record::new("flight.csv", time).unwrap();
    for (input, values) in vehicle.inputs.iter().zip(inputs) {
        record.push(&input.name, input.unit.si_symbol(), values).unwrap();
    }
    for (output, values) in vehicle.outputs.iter().zip(outputs) {
        record.push(&output.name, output.unit.si_symbol(), values).unwrap();
    }
    record
}

/// A record with one channel changed.
pub fn changed(record: &Record, channel: &str, f: impl Fn(usize, f64) -> f64) -> Record {
    let mut out = Record::new("flight.csv", record.time.clone()).unwrap();
    for signal in record.signals() {
        let values = signal.values.iter().enumerate();
        let values = values.map(|(k, v)| if signal.name == channel { f(k, *v) } else { *v }).collect();
        out.push(&signal.name, &signal.unit, values).unwrap();
    }
    out
}

/// A record without what lies between two times.
pub fn with_gap(record: &Record, from_s: f64, until_s: f64) -> Record {
    let kept: Vec<usize> =
        (0..record.len()).filter(|k| !(from_s..until_s).contains(&record.time[*k])).collect();
    let pick = |values: &[f64]| kept.iter().map(|k| values[*k]).collect::<Vec<f64>>();
    let mut out = Record::new("gap.csv", pick(&record.time)).unwrap();
    for signal in record.signals() {
        out.push(&signal.name, &signal.unit, pick(&signal.values)).unwrap();
    }
    out
}
