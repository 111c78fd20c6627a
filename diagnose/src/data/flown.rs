//! Simulated flights of a vehicle, for tests.

use whirlstand_vehicle::{Simulator, Vehicle};

use super::record::{Channel, Data};

/// A flight with these inputs (steps x inputs, row after row) at steps of 20 ms, without a filter that
/// follows it.
pub fn flown(vehicle: &Vehicle, inputs: Vec<f64>, seed: u64) -> Data {
    let (m, period_s) = (vehicle.inputs.len(), 0.02);
    let steps = inputs.len() / m;
    let mut simulator = Simulator::new(vehicle, period_s, seed).unwrap();
    let mut values = vec![Vec::new(); vehicle.outputs.len()];
    for u in inputs.chunks_exact(m) {
        simulator.apply(u);
        values.iter_mut().zip(simulator.measure()).for_each(|(v, y)| v.push(*y));
        simulator.advance();
    }
    let channel = |(output, values): (usize, Vec<f64>)| Channel {
        output,
        stride: 1,
        first: 0,
        good: vec![true; steps],
        early: Vec::new(),
        declared: 0.0,
        values,
    };
    Data {
        origin: "none".into(),
        start_s: 0.0,
        period_s,
        steps,
        inputs,
        m,
        starts: vec![0],
        clocks: vec![0],
        held: false,
        memory_s: None,
        likeliest_s: None,
        likeliest_filter: None,
        channels: values.into_iter().enumerate().map(channel).collect(),
    }
}
