//! Many steps at once are what the same steps are one by one.

use whirlstand_vehicle::{Rows, Simulator, Vehicle};

use crate::support::{EFFECTS, effect};

/// A correction of a state, as of an observer of the first output.
fn correction(step: usize, y: &[f64], x: f64) -> f64 {
    0.05 * ((step as f64 * 0.05).sin() - y[0]) - 0.01 * x
}

/// Outputs and states of every step, one by one and in blocks of 64 at most: corrected in the first third, a force on one
/// state in the second half.
fn both(vehicle: &Vehicle) -> [Vec<f64>; 2] {
    let (m, steps, forced) = (vehicle.inputs.len(), 300, 1);
    let inputs: Vec<f64> =
        (0..steps * m).map(|k| (k as f64 * 0.037).sin() + (k as f64 * 0.41).sin()).collect();
    let force: Vec<f64> = (0..steps).map(|k| (k as f64 * 0.09).cos()).collect();
    let parts = [0..steps / 3, steps / 3..steps / 2, steps / 2..steps];
    let begun = || {
        let mut simulator = Simulator::expected(vehicle, 0.01).unwrap();
        simulator.set_state(&vec![0.02; vehicle.states.len()]);
        simulator
    };
    let (mut simulator, mut alone) = (begun(), Vec::new());
    for (k, u) in inputs.chunks(m).enumerate() {
        if parts[2].contains(&k) {
            let mut derivative = vec![0.0; vehicle.states.len()];
            derivative[forced] = force[k];
            simulator.disturb(&derivative);
        }
        simulator.apply(u);
        let y = simulator.measure().to_vec();
        alone.extend_from_slice(&y);
        alone.extend_from_slice(simulator.state());
        if parts[0].contains(&k) {
            let change: Vec<f64> = simulator.state().iter().map(|x| correction(k, &y, *x)).collect();
            simulator.correct(&change);
        }
        simulator.advance();
    }
    alone.extend_from_slice(simulator.state());
    let (mut simulator, mut together) = (begun(), Vec::new());
    let mut rows = simulator.rows();
    for (part, range) in parts.into_iter().enumerate() {
        for from in range.clone().step_by(Rows::MOST) {
            let until = (from + Rows::MOST).min(range.end);
            let inputs = &inputs[from * m..until * m];
            let mut correct = |row: usize, y: &[f64], x: &mut [f64]| {
                x.iter_mut().for_each(|x| *x += correction(from + row, y, *x));
            };
            match part {
                0 => simulator.run_corrected_block(inputs, &mut correct, &mut rows),
                1 => simulator.run_block(inputs, &mut rows),
                _ => simulator.run_forced_block(inputs, Some((forced, &force[from..until])), &mut rows),
            }
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
