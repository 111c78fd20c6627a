//! Errors of the bus's sensors (measured minus true), which are applied to the autopilot's sensors as well.

use whirlstand_bridge::sensors::{Errors, Motion};
use whirlstand_msgs::{Imu, Odometry, valid};
use whirlstand_vehicle::{Stream, Vehicle};

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
/// and an estimator that received it repeatedly would take its noise for a bias: so noise is drawn anew for
/// every reading.
#[derive(Debug, Clone)]
pub(super) struct StandingErrors {
    /// Bias and standard deviation of angles, rates, positions and speeds.
    sizes: [[(f64, f64); 3]; 4],
    stream: Stream,
}

impl StandingErrors {
    pub(super) fn new(vehicle: &Vehicle, seed: u64) -> Self {
        let size = |name: &str| {
            let output = vehicle.output_index(name).filter(|_| vehicle.state_index(name).is_some());
            output.map_or((0.0, 0.0), |i| (vehicle.outputs[i].bias, vehicle.outputs[i].noise))
        };
        let sizes = [
            ["roll", "pitch", "yaw"],
            ["roll_rate", "pitch_rate", "yaw_rate"],
            ["longitudinal_position", "lateral_position", "height"],
            ["longitudinal_speed", "lateral_speed", "vertical_speed"],
        ];
        Self { sizes: sizes.map(|names| names.map(size)), stream: Stream::new(seed, "standing sensors") }
    }

    /// Draws the errors of the next reading.
    pub(super) fn draw(&mut self) -> Errors {
        let stream = &mut self.stream;
        let [angles, rates, position, speed] =
            self.sizes.map(|group| group.map(|(bias, noise)| bias + noise * stream.normal()));
        Errors { angles, rates, position, speed }
    }
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

    #[test]
    fn noise_of_a_standing_vehicle_is_that_of_its_sensors_and_never_the_same_twice() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let mut standing = StandingErrors::new(&vehicle, 1);
        let rate = &vehicle.outputs[vehicle.output_index("roll_rate").unwrap()];
        let drawn: Vec<f64> = (0..2000).map(|_| standing.draw().rates[0]).collect();
        assert!(drawn.windows(2).all(|pair| pair[0] != pair[1]));
        let mean = drawn.iter().sum::<f64>() / 2000.0;
        let deviation = (drawn.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 2000.0).sqrt();
        assert!((mean - rate.bias).abs() < 0.1 * rate.noise, "{mean} rad/s would be learnt as a bias");
        assert!((deviation / rate.noise - 1.0).abs() < 0.1, "{deviation}");
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
