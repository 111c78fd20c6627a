//! Errors of the bus's sensors (measured minus true), which are applied to the autopilot's sensors as well.

use whirlstand_bridge::sensors::{Errors, Motion};
use whirlstand_msgs::{Imu, Odometry, valid};
use whirlstand_vehicle::{Effect, Kind, Simulator, Vehicle};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::plant::simulation::simulated;
use crate::setup::Setup;

/// Maps the errors of the vehicle's outputs to sensors.
#[derive(Debug, Clone)]
pub(super) struct ErrorMap {
    angles: [bool; 3],
    rates: [bool; 3],
    positions: [bool; 3],
    speeds: [bool; 3],
    /// Last errors; values that are not fresh keep theirs.
    last: Errors,
}

impl ErrorMap {
    pub(super) fn new(vehicle: &Vehicle) -> Self {
        let both = |name: &str| vehicle.output_index(name).is_some() && vehicle.state_index(name).is_some();
        Self {
            angles: ["roll", "pitch", "yaw"].map(both),
            rates: ["roll_rate", "pitch_rate", "yaw_rate"].map(both),
            positions: ["longitudinal_position", "lateral_position", "height"].map(both),
            speeds: ["longitudinal_speed", "lateral_speed", "vertical_speed"].map(both),
            last: Errors::default(),
        }
    }

    /// Errors at a step with the true motion `truth`.
    pub(super) fn of(&mut self, imu: &Imu, odometry: Option<&Odometry>, truth: &Motion) -> Errors {
        let last = &mut self.last;
        let fresh = |flags: u32, bit: u32| flags & bit != 0;
        if fresh(imu.valid, valid::FIRST) {
            differ(&mut last.angles, self.angles, [imu.roll, imu.pitch, imu.yaw], truth.angles.map(Some));
        }
        if fresh(imu.valid, valid::SECOND) {
            let measured = [imu.roll_rate, imu.pitch_rate, imu.yaw_rate];
            differ(&mut last.rates, self.rates, measured, truth.rates.map(Some));
        }
        if let Some(o) = odometry {
            if fresh(o.valid, valid::FIRST) {
                let measured = [o.longitudinal_position, o.lateral_position, o.height];
                differ(&mut last.position, self.positions, measured, truth.axes.map(|a| a.position));
            }
            if fresh(o.valid, valid::SECOND) {
                let measured = [o.longitudinal_speed, o.lateral_speed, o.vertical_speed];
                differ(&mut last.speed, self.speeds, measured, truth.axes.map(|a| a.speed));
            }
        }
        *last
    }
}

/// Sensor errors of a vehicle that waits at rest. The plant repeats the single measurement of step 0 then,
/// and an estimator that received it repeatedly would take its noise for a bias: so the vehicle's sensors
/// measure anew for every reading, with everything that disturbs them all the time.
#[derive(Debug, Clone)]
pub(super) struct StandingErrors {
    simulator: Simulator,
    /// The state in which the vehicle waits, and inputs that keep it there for a period.
    rest: Vec<f64>,
    neutral: Vec<f64>,
    /// Output and state of each of the angles, rates, positions and speeds.
    places: [[Option<(usize, usize)>; 3]; 4],
}

impl StandingErrors {
    /// Sensors of the vehicle with its own effects and those of the launch file.
    ///
    /// # Errors
    /// An effect or an initial state that does not fit the vehicle.
    pub(super) fn of(config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let (mut config, mut setup) = (config.clone(), setup.clone());
        config.effects.retain(acts_on_standing_sensors);
        setup.vehicle.effects.retain(acts_on_standing_sensors);
        // Other noise than that of the first steps of the run.
        config.seed = !config.seed;
        let (simulator, _) = simulated(&config, &setup)?;
        Ok(Self::new(&setup.vehicle, simulator))
    }

    fn new(vehicle: &Vehicle, simulator: Simulator) -> Self {
        let place = |name: &str| vehicle.output_index(name).zip(vehicle.state_index(name));
        let places = [
            ["roll", "pitch", "yaw"],
            ["roll_rate", "pitch_rate", "yaw_rate"],
            ["longitudinal_position", "lateral_position", "height"],
            ["longitudinal_speed", "lateral_speed", "vertical_speed"],
        ];
        Self {
            rest: simulator.state().to_vec(),
            neutral: vec![0.0; vehicle.inputs.len()],
            places: places.map(|names| names.map(place)),
            simulator,
        }
    }

    /// The errors of the next reading.
    pub(super) fn draw(&mut self) -> Errors {
        let (measured, rest) = (self.simulator.measure(), &self.rest);
        let error = |place: Option<(usize, usize)>| {
            place.map_or(0.0, |(output, state)| measured[output] - rest[state])
        };
        let [angles, rates, position, speed] = self.places.map(|group| group.map(error));
        self.simulator.step(&self.neutral);
        self.simulator.set_state(&self.rest);
        Errors { angles, rates, position, speed }
    }
}

/// True for an effect on sensors that acts all the time and alike: a drift begins with the run.
fn acts_on_standing_sensors(effect: &Effect) -> bool {
    let acts = matches!(
        effect.kind(),
        Kind::SensorBias
            | Kind::SensorScale
            | Kind::Misalignment
            | Kind::Vibration
            | Kind::Noise
            | Kind::Quantization
            | Kind::OutputSaturation
            | Kind::Dropouts
            | Kind::Outliers
    );
    acts && effect.window().is_always()
}

fn differ(errors: &mut [f64; 3], present: [bool; 3], measured: [f64; 3], truth: [Option<f64>; 3]) {
    for (((error, present), measured), truth) in errors.iter_mut().zip(present).zip(measured).zip(truth) {
        if let Some(truth) = truth.filter(|_| present && measured.is_finite()) {
            *error = measured - truth;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::Message;
    use whirlstand_vehicle::{Engine, Window};

    /// The standing sensors of a built-in quadrotor with these effects.
    fn standing(effects: &[Effect]) -> (Vehicle, StandingErrors) {
        let mut vehicle = Vehicle::builtin("quadrotor").unwrap();
        for effect in effects.iter().filter(|e| acts_on_standing_sensors(e)) {
            vehicle.add_effect(effect.clone()).unwrap();
        }
        let simulator = Simulator::new(&vehicle, 0.004, 1).unwrap();
        let standing = StandingErrors::new(&vehicle, simulator);
        (vehicle, standing)
    }

    #[test]
    fn effects_that_act_all_the_time_act_on_a_standing_vehicle_as_well() {
        let effect = |kind, parameters: &[_]| Effect::new(kind, "roll_rate", parameters).unwrap();
        let late = Window { from_s: Some(0.5), until_s: None };
        let (_, mut standing) = standing(&[
            effect(Kind::Vibration, &[("frequency_hz", 20.0), ("amplitude", 0.5)]),
            effect(Kind::SensorBias, &[("offset", 0.2)]),
            effect(Kind::SensorDrift, &[("rate_per_s", 10.0)]),
            effect(Kind::SensorBias, &[("offset", 50.0)]).during(late).unwrap(),
        ]);
        // Whole periods of the tone.
        let drawn: Vec<f64> = (0..1000).map(|_| standing.draw().rates[0]).collect();
        let mean = drawn.iter().sum::<f64>() / 1000.0;
        let largest = drawn.iter().map(|e| (e - mean).abs()).fold(0.0, f64::max);
        assert!((mean - 0.2).abs() < 0.02, "{mean}: a drift or a later bias acts before the run");
        assert!((0.45..0.7).contains(&largest), "{largest}: no vibration");
    }

    #[test]
    fn noise_of_a_standing_vehicle_is_that_of_its_sensors_and_never_the_same_twice() {
        let (vehicle, mut standing) = standing(&[]);
        let rate = &vehicle.outputs[vehicle.output_index("roll_rate").unwrap()];
        let drawn: Vec<f64> = (0..2000).map(|_| standing.draw().rates[0]).collect();
        assert!(drawn.windows(2).all(|pair| pair[0] != pair[1]));
        let mean = drawn.iter().sum::<f64>() / 2000.0;
        let deviation = (drawn.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 2000.0).sqrt();
        assert!((mean - rate.bias).abs() < 0.1 * rate.noise, "{mean} rad/s would be learnt as a bias");
        // Of noise and of the vibration that the vehicle file declares.
        let expected = rate.sensor_std(Engine::default(), 0.0);
        assert!((deviation / expected - 1.0).abs() < 0.1, "{deviation}, not {expected}");
    }

    #[test]
    fn errors_are_those_of_fresh_values_of_outputs_that_are_there() {
        let mut map = ErrorMap::new(&Vehicle::builtin("quadrotor").unwrap());
        let truth = Motion { angles: [0.1, 0.2, 0.3], rates: [1.0, 2.0, 3.0], ..Motion::default() };
        let mut imu = Imu { roll: 0.15, pitch: 0.2, yaw: 9.0, roll_rate: 0.5, valid: 1, ..Imu::zeroed() };
        let errors = map.of(&imu, None, &truth);
        assert!((errors.angles[0] - 0.05).abs() < 1e-12);
        assert_eq!(errors.angles[2], 0.0, "the vehicle has no yaw");
        assert_eq!(errors.rates, [0.0; 3], "not fresh");
        imu.valid = 2;
        imu.roll = 77.0;
        imu.pitch_rate = f64::NAN;
        let errors = map.of(&imu, None, &truth);
        assert!((errors.angles[0] - 0.05).abs() < 1e-12, "stays");
        assert_eq!((errors.rates[0], errors.rates[1]), (-0.5, 0.0));
    }
}
