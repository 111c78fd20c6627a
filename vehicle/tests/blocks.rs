//! Many steps at once are what the same steps are one by one.

use whirlstand_vehicle::{Effect, Rows, Simulator, Vehicle};

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

fn effect(text: &str) -> Effect {
    toml::from_str(&text.replace("; ", "\n")).unwrap()
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

const EFFECTS: &[&str] = &[
    "effect = 'input_delay'; where = 'u_roll'; delay_s = 0.033",
    "effect = 'actuator_lag'; where = 'u_roll'; time_constant_s = 0.05",
    "effect = 'input_gain'; where = 'u_pitch'; factor = 0.9",
    "effect = 'gain_drift'; where = 'u_pitch'; rate_per_s = -0.01",
    "effect = 'input_bias'; where = 'u_pitch'; offset = 0.1",
    "effect = 'dead_zone'; where = 'u_roll'; width = 0.05",
    "effect = 'input_saturation'; where = 'u_roll'; lower = -3; upper = 3",
    "effect = 'rate_limit'; where = 'u_roll'; limit_per_s = 5",
    "effect = 'backlash'; where = 'u_roll'; width = 0.1",
    "effect = 'input_coupling'; where = 'u_roll->u_pitch'; coefficient = 0.2",
    "effect = 'parameter_change'; where = 'A[2,1]'; factor = 1.2",
    "effect = 'quadratic_drag'; where = 'lateral_speed'; coefficient = 0.1",
    "effect = 'coulomb_friction'; where = 'roll_rate'; level = 0.05",
    "effect = 'cubic_stiffness'; where = 'roll->roll_rate'; coefficient = 1.0",
    "effect = 'unmodelled_mode'; where = 'u_pitch'; frequency_hz = 8; damping_ratio = 0.05",
    "effect = 'step_disturbance'; where = 'pitch_rate'; at_s = 1.0012; magnitude = 0.1",
    "effect = 'pulse_disturbance'; where = 'roll_rate'; at_s = 2.0012; duration_s = 0.2; magnitude = 1",
    "effect = 'periodic_disturbance'; where = 'roll_rate'; frequency_hz = 2; amplitude = 0.1",
    "effect = 'turbulence'; where = 'lateral_speed'; std = 0.3; bandwidth_hz = 0.5",
    "effect = 'mode_transition'; where = 'vehicle'; at_s = 5.001; to = 'helicopter-lateral'",
    "effect = 'sensor_bias'; where = 'roll'; offset = '1 deg'",
    "effect = 'sensor_drift'; where = 'roll'; rate_per_s = 0.001",
    "effect = 'sensor_scale'; where = 'pitch'; factor = 1.05",
    "effect = 'sensor_delay'; where = 'roll'; delay_s = 0.012",
    "effect = 'sensor_lag'; where = 'pitch'; time_constant_s = 0.03",
    "effect = 'misalignment'; where = 'roll,pitch'; angle_rad = 0.05",
    "effect = 'vibration'; where = 'roll'; frequency_hz = 17; amplitude = 0.01; source = 'tail rotor'",
    "effect = 'noise'; where = 'roll'; std = 0.01",
    "effect = 'quantization'; where = 'roll'; step = 0.001",
    "effect = 'output_saturation'; where = 'roll'; lower = -1; upper = 1",
    "effect = 'dropouts'; where = 'roll'; fraction = 0.1",
    "effect = 'outliers'; where = 'roll'; fraction = 0.01; magnitude = 0.1",
];
