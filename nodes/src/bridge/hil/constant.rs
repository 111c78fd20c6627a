//! Sensors that read the same value again and again while the vehicle is at rest, as no real sensor does.

use whirlstand_bridge::autopilot::AutopilotKind;
use whirlstand_bridge::sensors::{Errors, Motion, SensorModel, Sensors};

/// Number of equal readings after which PX4 takes a sensor for failed, and the largest difference between two
/// equal ones, in the units that are sent to it.
///
/// Source: `src/modules/sensors/data_validator/DataValidator.hpp` and `.cpp` of PX4.
const READINGS: usize = 100;
const EQUAL: f64 = 1e-6;

/// A sensor of an autopilot.
struct Sensor {
    name: &'static str,
    /// Key of its noise in the launch file.
    key: &'static str,
    /// Outputs of the vehicle whose errors it has as well.
    outputs: Option<&'static str>,
    reading: fn(&Sensors) -> [f64; 3],
}

/// All sensors; those that every autopilot receives come first.
const SENSORS: [Sensor; 4] = [
    Sensor {
        name: "gyroscope",
        key: "bridge.sensors.gyro_noise",
        outputs: Some("rates"),
        reading: |s| s.gyro.into(),
    },
    Sensor {
        name: "accelerometer",
        key: "bridge.sensors.accel_noise",
        outputs: Some("angles"),
        reading: |s| s.accel.into(),
    },
    Sensor {
        name: "barometer",
        key: "bridge.sensors.baro_noise",
        outputs: None,
        reading: |s| [1e-2 * s.pressure, 0.0, 0.0],
    },
    Sensor {
        name: "magnetometer",
        key: "bridge.sensors.mag_noise",
        outputs: None,
        reading: |s| (1e4 * s.mag).into(),
    },
];

/// The sensors that are sent to an autopilot.
fn sent_to(kind: AutopilotKind) -> &'static [Sensor] {
    match kind {
        AutopilotKind::Px4Hil => &SENSORS,
        AutopilotKind::ArdupilotJson => &SENSORS[..2],
        AutopilotKind::BetaflightSitl => &SENSORS[..3],
    }
}

/// A warning about the sensors of this autopilot that do not change while the vehicle is at rest, if there are any.
/// `errors` draws the errors of the vehicle's outputs.
pub(in crate::bridge) fn constant_sensors(
    kind: AutopilotKind,
    model: &SensorModel,
    mut errors: impl FnMut() -> Errors,
) -> Option<String> {
    let mut model = model.clone();
    let readings: Vec<Sensors> = (0..=READINGS).map(|_| model.step(&Motion::default(), &errors())).collect();
    let is_constant = |sensor: &&Sensor| {
        readings.windows(2).all(|pair| {
            let [before, after] = [&pair[0], &pair[1]].map(sensor.reading);
            before.iter().zip(after).all(|(before, after)| (before - after).abs() < EQUAL)
        })
    };
    let constant: Vec<_> = sent_to(kind).iter().filter(is_constant).collect();
    if constant.is_empty() {
        return None;
    }
    let list =
        |part: fn(&Sensor) -> &'static str| constant.iter().map(|s| part(s)).collect::<Vec<_>>().join(", ");
    let outputs: Vec<_> = constant.iter().filter_map(|sensor| sensor.outputs).collect();
    let or = match &outputs[..] {
        [] => String::new(),
        outputs => {
            format!("; for a flight, noise of the {} in the vehicle file will do", outputs.join(" and "))
        }
    };
    Some(format!(
        "without noise, these sensors stand still while the vehicle is at rest, and {} may take them for failed (PX4 does after \
         {READINGS} equal readings): {}; set {} above 0{or}",
        kind.autopilot(),
        list(|s| s.name),
        list(|s| s.key),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_bridge::sensors::SensorOptions;

    #[test]
    fn sensors_without_any_noise_are_told_with_the_keys_that_give_it() {
        let told = |options: SensorOptions, kind, noise: f64| {
            let model = SensorModel::new(options, 4_000_000, 1);
            let mut sign = noise;
            constant_sensors(kind, &model, || {
                sign = -sign;
                Errors { rates: [sign, 0.0, 0.0], ..Errors::default() }
            })
        };
        let silent = SensorOptions {
            gyro_noise: 0.0,
            accel_noise: 0.0,
            mag_noise: 0.0,
            baro_noise: 0.0,
            ..SensorOptions::default()
        };
        assert_eq!(told(SensorOptions::default(), AutopilotKind::Px4Hil, 0.0), None);
        let all = told(silent.clone(), AutopilotKind::Px4Hil, 0.0).unwrap();
        for words in [
            "PX4 may take",
            "gyroscope, accelerometer, barometer, magnetometer",
            "bridge.sensors.mag_noise above 0",
        ] {
            assert!(all.contains(words), "{words}: {all}");
        }
        assert!(all.ends_with("noise of the rates and angles in the vehicle file will do"), "{all}");
        let rest = told(silent, AutopilotKind::ArdupilotJson, 0.01).unwrap();
        assert!(rest.contains(": accelerometer; set bridge.sensors.accel_noise above 0"), "{rest}");
        let quiet_air = SensorOptions { baro_noise: 0.0, ..SensorOptions::default() };
        assert_eq!(told(quiet_air.clone(), AutopilotKind::ArdupilotJson, 0.0), None, "it is not sent");
        let told = told(quiet_air, AutopilotKind::BetaflightSitl, 0.0).unwrap();
        assert!(told.ends_with("barometer; set bridge.sensors.baro_noise above 0"), "{told}");
    }
}
