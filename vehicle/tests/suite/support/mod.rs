//! Every effect once, as a vehicle file writes it.

use whirlstand_vehicle::Effect;

/// The effect of one line of [`EFFECTS`].
pub fn effect(text: &str) -> Effect {
    toml::from_str(&text.replace("; ", "\n")).unwrap()
}

/// For a vehicle with the inputs and states of `helicopter-hover`.
pub const EFFECTS: &[&str] = &[
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
