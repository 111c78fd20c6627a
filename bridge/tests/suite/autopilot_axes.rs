//! The tables of the bridges to PX4 and ArduPilot, row by row: the vehicle is pushed about and along each axis alone, to both
//! sides, and the outputs push each of its inputs alone. Betaflight's table is beside its packets.

use std::time::Duration;

use whirlstand_bridge::autopilot::ardupilot::{Ardupilot, ArdupilotOptions, ServoPacket};
use whirlstand_bridge::autopilot::betaflight::{self, Betaflight, BetaflightOptions};
use whirlstand_bridge::autopilot::px4::{self, Px4, Px4Options};
use whirlstand_bridge::autopilot::{Autopilot, Event, Rc, ardupilot};
use whirlstand_bridge::mavlink::dialect::{
    HIL_ACTUATOR_CONTROLS_DATA, HilActuatorControlsFlags, MavModeFlag,
};
use whirlstand_bridge::mavlink::{self, Deframer, Encoder, MavMessage};
use whirlstand_bridge::mixer::{Mixer, MixerOptions};
use whirlstand_bridge::sensors::{Axis, Errors, Motion, SensorModel, SensorOptions};
use whirlstand_vehicle::Vehicle;

const PERIOD_NS: u64 = 4_000_000;
const DT: f64 = 4e-3;
const G: f64 = 9.80665;
const SIZE: f64 = 0.01;

/// What an autopilot is told, in the units and frames of the bus: SI, FRD and NED.
#[derive(Debug, Default)]
struct SensorValues {
    gyro: [f64; 3],
    accel: [f64; 3],
    quaternion: [f64; 4],
    velocity: [f64; 3],
    position: [f64; 3],
}

/// Reads both ends of a push: the sensors before and after the vehicle moved from rest to `motion`.
fn push(
    motion: Motion,
    mut read: impl FnMut(&whirlstand_bridge::sensors::Sensors) -> SensorValues,
) -> SensorValues {
    let options = SensorOptions {
        gyro_noise: 0.0,
        accel_noise: 0.0,
        baro_noise: 0.0,
        gps_hz: 250.0,
        ..SensorOptions::default()
    };
    let mut model = SensorModel::new(options, PERIOD_NS, 1);
    let axes = [Axis { position: Some(0.0), speed: None }; 3];
    let rest = Motion { axes, ..Motion::default() };
    read(&model.step(&rest, &Errors::default()));
    let before = read(&model.step(&rest, &Errors::default()));
    let mut after = read(&model.step(&motion, &Errors::default()));
    after.position = std::array::from_fn(|i| after.position[i] - before.position[i]);
    after
}

fn px4_values() -> impl FnMut(&whirlstand_bridge::sensors::Sensors) -> SensorValues {
    let mut px4 = Px4::new(Px4Options::default(), true);
    let mut deframer = Deframer::new();
    let mut now = Duration::ZERO;
    let mut values = SensorValues::default();
    move |sensors| {
        now += Duration::from_nanos(PERIOD_NS);
        px4.sense(sensors, &Rc::default(), now, &mut |_, bytes| deframer.push(bytes));
        while let Some(mavlink::Event::Message(_, message)) = deframer.next(now) {
            match message {
                MavMessage::HIL_SENSOR(m) => {
                    values.gyro = [m.xgyro, m.ygyro, m.zgyro].map(f64::from);
                    values.accel = [m.xacc, m.yacc, m.zacc].map(f64::from);
                }
                MavMessage::HIL_STATE_QUATERNION(m) => {
                    values.quaternion = m.attitude_quaternion.map(f64::from)
                }
                MavMessage::HIL_GPS(m) => {
                    values.velocity = [m.vn, m.ve, m.vd].map(|v| f64::from(v) * 1e-2);
                    // A degree of latitude is 111 km; that of longitude is shorter by the cosine of the latitude.
                    let metres = [1.1119e-2, 1.1119e-2 * 47.4f64.to_radians().cos()];
                    values.position = [
                        f64::from(m.lat) * metres[0],
                        f64::from(m.lon) * metres[1],
                        f64::from(m.alt) * -1e-3,
                    ];
                }
                _ => {}
            }
        }
        std::mem::replace(
            &mut values,
            SensorValues { quaternion: [1.0, 0.0, 0.0, 0.0], ..SensorValues::default() },
        )
    }
}

fn ardupilot_values() -> impl FnMut(&whirlstand_bridge::sensors::Sensors) -> SensorValues {
    let mut ardupilot = Ardupilot::new(ArdupilotOptions::default(), true);
    let mut number = 0;
    move |sensors| {
        ardupilot.receive(0, &ServoPacket::bytes(400, number, &[1500; 16]), Duration::ZERO, &mut |_, _| {});
        number += 1;
        let mut line = Vec::new();
        ardupilot.sense(sensors, &Rc::default(), Duration::ZERO, &mut |_, bytes| line = bytes.to_vec());
        let json: serde_json::Value = serde_json::from_slice(&line).unwrap();
        let list = |v: &serde_json::Value| {
            v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect::<Vec<_>>()
        };
        let three = |v: &serde_json::Value| -> [f64; 3] { list(v).try_into().unwrap() };
        SensorValues {
            gyro: three(&json["imu"]["gyro"]),
            accel: three(&json["imu"]["accel_body"]),
            quaternion: list(&json["quaternion"]).try_into().unwrap(),
            velocity: three(&json["velocity"]),
            position: three(&json["position"]),
        }
    }
}

#[track_caller]
fn near(name: &str, found: &[f64], wanted: &[f64], tolerance: f64) {
    let far = found.iter().zip(wanted).any(|(f, w)| (f - w).abs() > tolerance);
    assert!(!far, "{name}: {found:?} is not {wanted:?}");
}

fn each_axis(name: &str, mut push_one: impl FnMut(Motion) -> SensorValues) {
    let axes = [Axis { position: Some(0.0), speed: None }; 3];
    for axis in 0..3 {
        for size in [SIZE, -SIZE] {
            let mut motion = Motion { axes, ..Motion::default() };
            motion.angles[axis] = size;
            let values = push_one(motion);
            let name = format!("{name}, turned by {size} about axis {axis}");
            let mut gyro = [0.0; 3];
            gyro[axis] = size / DT;
            near(&name, &values.gyro, &gyro, 1e-5);
            // Half way through the turn gravity is felt from half of the angle: right side down from the left, nose up
            // from the front.
            let felt = [[0.0, -G * size / 2.0, -G], [G * size / 2.0, 0.0, -G], [0.0, 0.0, -G]][axis];
            near(&name, &values.accel, &felt, 1e-3);
            let mut quaternion = [1.0, 0.0, 0.0, 0.0];
            quaternion[1 + axis] = size / 2.0;
            near(&name, &values.quaternion, &quaternion, 1e-4);
            near(&name, &values.velocity, &[0.0; 3], 1e-9);

            // Forward, right, up is north, east and not down.
            let mut motion = Motion { axes, ..Motion::default() };
            motion.axes[axis].position = Some(4.0 * size);
            let values = push_one(motion);
            let sign = if axis == 2 { -1.0 } else { 1.0 };
            let (mut moved, mut speed) = ([0.0; 3], [0.0; 3]);
            (moved[axis], speed[axis]) = (sign * 4.0 * size, sign * 4.0 * size / DT);
            near(&name, &values.velocity, &speed, 1e-9);
            near(&name, &values.position, &moved, 0.006);
            near(&name, &values.gyro, &[0.0; 3], 1e-9);
        }
    }
}

#[test]
fn every_axis_reaches_px4_alone_with_its_sign() {
    each_axis("PX4", |motion| push(motion, px4_values()));
}

#[test]
fn every_axis_reaches_ardupilot_alone_with_its_sign() {
    each_axis("ArduPilot", |motion| push(motion, ardupilot_values()));
}

/// The packet in which an autopilot says that its outputs, in its own order, are these; 0 to 1.
fn said(name: &str, outputs: [f64; 4]) -> (Box<dyn Autopilot>, usize, Vec<u8>) {
    let pulse = |i: usize| 1000.0 + 1000.0 * outputs.get(i).copied().unwrap_or(0.0);
    match name {
        "PX4" => {
            let mut bytes = Vec::new();
            let message = HIL_ACTUATOR_CONTROLS_DATA {
                time_usec: 1,
                controls: std::array::from_fn(|i| outputs.get(i).map_or(f32::NAN, |v| *v as f32)),
                mode: MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
                flags: HilActuatorControlsFlags::empty(),
            };
            Encoder::new(1, 1).encode(
                &MavMessage::HIL_ACTUATOR_CONTROLS(message),
                Duration::ZERO,
                &mut bytes,
            );
            (Box::new(Px4::new(Px4Options::default(), true)), 0, bytes)
        }
        "ArduPilot" => {
            let bytes = ServoPacket::bytes(400, 0, &std::array::from_fn(|i| pulse(i) as u16));
            (Box::new(Ardupilot::new(ArdupilotOptions::default(), true)), 0, bytes)
        }
        _ => {
            let bytes = betaflight::raw_bytes(4, &std::array::from_fn(|i| pulse(i) as f32)).to_vec();
            (Box::new(Betaflight::new(BetaflightOptions::default(), true)), betaflight::RAW, bytes)
        }
    }
}

#[test]
fn every_axis_of_the_motors_moves_its_input_alone() {
    let vehicle = Vehicle::builtin("quadrotor").unwrap();
    // The places of each autopilot's outputs 1 to 4, as its manual draws them: front or rear, right or left.
    let (fr, rl, fl, rr) = ([1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]);
    for (name, places, native) in [
        ("PX4", [fr, rl, fl, rr], px4::NATIVE_ORDER),
        ("ArduPilot", [fr, rl, fl, rr], ardupilot::NATIVE_ORDER),
        ("Betaflight", [rr, fr, rl, fl], betaflight::NATIVE_ORDER),
    ] {
        let mixer = Mixer::new(&MixerOptions::default(), &native, &vehicle).unwrap();
        for axis in 0..2 {
            for size in [0.25, -0.25] {
                // A roll to the right is more thrust on the left, nose up is more thrust in front.
                let outputs =
                    places.map(|[front, right]| 0.5 + size * if axis == 0 { -right } else { front });
                let (mut autopilot, port, bytes) = said(name, outputs);
                autopilot.receive(port, &bytes, Duration::ZERO, &mut |_, _| {});
                let Some(Event::Outputs(outputs)) = autopilot.next() else { panic!("{name}") };
                let mut u = [f64::NAN; 2];
                mixer.mix(&outputs.values, &mut u);
                // In the paper's quadrotor both inputs turn the model the other way; half of full is 10 of 20.
                let mut wanted = [0.0; 2];
                wanted[axis] = -20.0 * 2.0 * size;
                near(&format!("{name}, axis {axis}"), &u, &wanted, 1e-5);
            }
        }
    }
}
