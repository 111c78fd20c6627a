//! Many steps at once are what the same steps are one by one.

use whirlstand_vehicle::{Rows, Simulator, Vehicle};

use crate::support::{EFFECTS, effect};

/// Outputs and states of every step, one by one and in blocks of 64 at most; a force on one state in the second half.
fn both(vehicle: &Vehicle) -> [Vec<f64>; 2] {
    let (m, steps, forced) = (vehicle.inputs.len(), 300, 1);
    let inputs: Vec<f64> =
        (0..steps * m).map(|k| (k as f64 * 0.037).sin() + (k as f64 * 0.41).sin()).collect();
    let force: Vec<f64> = (0..steps).map(|k| (k as f64 * 0.09).cos()).collect();
    let begun = || {
        let mut simulator = Simulator::expected(vehicle, 0.01).unwrap();
        simulator.set_state(&vec![0.02; vehicle.states.len()]);
        simulator
    };
    let (mut simulator, mut alone) = (begun(), Vec::new());
    for (k, u) in inputs.chunks(m).enumerate() {
        if k >= steps / 2 {
            let mut derivative = vec![0.0; vehicle.states.len()];
            derivative[forced] = force[k];
            simulator.disturb(&derivative);
        }
        simulator.apply(u);
        alone.extend_from_slice(simulator.measure());
        alone.extend_from_slice(simulator.state());
        simulator.advance();
    }
    alone.extend_from_slice(simulator.state());
    let (mut simulator, mut together) = (begun(), Vec::new());
    let mut rows = simulator.rows();
    let halves = [0..steps / 2, steps / 2..steps];
    for (half, range) in halves.into_iter().enumerate() {
        for from in range.clone().step_by(Rows::MOST) {
            let until = (from + Rows::MOST).min(range.end);
            let force = (half == 1).then_some((forced, &force[from..until]));
            simulator.run_forced_block(&inputs[from * m..until * m], force, &mut rows);
            for row in 0..until - from {
                together.extend((0..vehicle.outputs.len()).map(|i| rows.output(i)[row]));
                together.extend((0..vehicle.states.len()).map(|i| rows.state(i)[row]));
            }
        }
    }
    together.extend_from_slice(simulator.state());
    [alone, together]
}

#[test]
fn blocks_are_their_steps_with_every_effect() {
    for name in ["quadrotor", "helicopter-hover"] {
        let plain = Vehicle::builtin(name).unwrap();
        let [alone, together] = both(&plain);
        assert!(alone == together, "{name}");
        for text in EFFECTS {
            let mut vehicle = plain.clone();
            // Some places are the helicopter's alone.
            if vehicle.add_effect(effect(text)).is_ok() {
                let [alone, together] = both(&vehicle);
                assert!(alone == together, "{name}: {text}");
            }
        }
    }
}

#[test]
fn blocks_are_their_steps_with_states_of_any_number() {
    let mut vehicle = Vehicle::builtin("helicopter-hover").unwrap();
    let lag = "effect = 'actuator_lag'; where = 'u_roll'; time_constant_s = 0.05";
    // 8 states, and a filter each: from one to the next length of the kernels, and beyond the longest.
    for filters in 1..12 {
        vehicle.add_effect(effect(lag)).unwrap();
        let [alone, together] = both(&vehicle);
        assert!(alone == together, "{filters} filters");
    }
}
