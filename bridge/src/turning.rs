//! Rotation of a vehicle according to its file: the signs of its channels, and the model for the sign watch.

use whirlstand_vehicle::{Engine, Vehicle};

use crate::channels::Input;

/// The angles, in the order of [`Input::turns`]; the name of each rate has the suffix `_rate`.
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];

/// Rotation of a vehicle without inputs, and noise of its attitude.
#[derive(Debug, Clone, Copy, Default)]
pub struct OwnMotion {
    /// Angular acceleration about each axis per unit of roll, pitch, yaw and their rates, 1/s^2 and 1/s.
    pub adds: [[f64; 6]; 3],
    /// Standard deviations of the sensors of roll, pitch, yaw and their rates, rad and rad/s; 0 without a
    /// sensor in the file.
    pub noise: [f64; 6],
}

/// The inputs of a vehicle, as used by a bridge.
///
/// Where no input accelerates an angle directly, because states of the actuators are in between, the sign is
/// that of the first derivative that an input affects.
pub fn inputs_of(vehicle: &Vehicle) -> Vec<Input> {
    let rates: [Option<usize>; 3] = std::array::from_fn(|axis| rate_state(vehicle, axis));
    let mut reach = vehicle.b.clone();
    let mut turns = vec![[0.0; 3]; vehicle.inputs.len()];
    for _ in 0..vehicle.states.len() {
        for (i, turns) in turns.iter_mut().enumerate().filter(|(_, t)| **t == [0.0; 3]) {
            *turns = rates.map(|state| state.map_or(0.0, |s| reach[(s, i)]));
        }
        reach = &vehicle.a * reach;
    }
    let input = |(i, turns): (&whirlstand_vehicle::Input, [f64; 3])| Input {
        name: i.name.clone(),
        full: i.upper.abs().max(i.lower.abs()),
        turns,
    };
    vehicle.inputs.iter().zip(turns).map(input).collect()
}

/// Angular acceleration due to a vehicle's own attitude, and the noise of its sensors in flight.
pub fn own_motion_of(vehicle: &Vehicle) -> OwnMotion {
    let states: [Option<usize>; 6] = std::array::from_fn(|i| match ANGLES.get(i) {
        Some(angle) => vehicle.state_index(angle),
        None => rate_state(vehicle, i - ANGLES.len()),
    });
    let adds = std::array::from_fn(|axis| {
        let Some(row) = rate_state(vehicle, axis) else { return [0.0; 6] };
        states.map(|state| state.map_or(0.0, |s| vehicle.a[(row, s)]))
    });
    let noise = states.map(|state| {
        let name = state.map(|s| vehicle.states[s].name.as_str());
        let sensor = vehicle.outputs.iter().find(|output| Some(output.name.as_str()) == name);
        sensor.map_or(0.0, |s| s.sensor_std(Engine::Flying, 0.0))
    });
    OwnMotion { adds, noise }
}

/// The state that is the rate of an angle: by its name, or by the row of A that defines it.
fn rate_state(vehicle: &Vehicle, axis: usize) -> Option<usize> {
    let named = vehicle.state_index(&format!("{}_rate", ANGLES[axis]));
    let integral = || {
        let (state, factor) = vehicle.kinematic_row(vehicle.state_index(ANGLES[axis])?)?;
        (factor > 0.0).then_some(state)
    };
    named.or_else(integral)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_are_those_of_b_also_behind_actuators() {
        let inputs = inputs_of(&Vehicle::builtin("quadrotor").unwrap());
        let signs = |i: &Input| i.turns.map(|t| if t == 0.0 { 0.0 } else { t.signum() });
        assert_eq!((inputs[0].axis(), signs(&inputs[0])), (Some(0), [-1.0, -1.0, 0.0]));
        assert_eq!((inputs[1].axis(), signs(&inputs[1])), (Some(1), [0.0, -1.0, 0.0]));
        let inputs = inputs_of(&Vehicle::builtin("helicopter-hover").unwrap());
        assert_eq!((signs(&inputs[0])[0], signs(&inputs[1])[1]), (1.0, -1.0));
        // A motor between the input and the rate.
        let text = r#"
name = "lagging"
A = [[0.0, 1.0, 0.0], [0.0, 0.0, -2.0], [0.0, 0.0, -5.0]]
B = [[0.0], [0.0], [5.0]]
states = [{ name = "roll", unit = "rad" }, { name = "roll_rate", unit = "rad/s" }, { name = "motor" }]
inputs = [{ name = "aileron", lower = -1.0, upper = 1.0 }]
outputs = [{ name = "roll", unit = "rad" }]
"#;
        let inputs = inputs_of(&Vehicle::parse(text, "lagging.toml").unwrap());
        assert_eq!((inputs[0].axis(), inputs[0].turns), (Some(0), [-10.0, 0.0, 0.0]));
    }

    #[test]
    fn its_own_motion_is_that_of_a() {
        let own = own_motion_of(&Vehicle::builtin("quadrotor").unwrap());
        let adds = own.adds;
        assert!((adds[1][0] - 7.2721).abs() < 1e-9 && (adds[1][3] - 6.1794).abs() < 1e-9, "{own:?}");
        assert!((adds[1][1] + 7.9908).abs() < 1e-9 && adds[2] == [0.0; 6], "{own:?}");
        // 0.08 deg, and a vibration of 0.08 deg and half of it.
        assert!((own.noise[0].to_degrees() - 0.102).abs() < 1e-3 && own.noise[5] == 0.0, "{own:?}");
    }
}
