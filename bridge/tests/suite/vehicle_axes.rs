//! The tables of the bridges to a vehicle, row by row: each axis is pushed alone, to both sides, and nothing else moves.

use std::time::Duration;

use whirlstand_bridge::arming::{ArmBy, Mode};
use whirlstand_bridge::config::{BridgeConfig, BridgeKind};
use whirlstand_bridge::mavlink::{MavMessage, dialect};
use whirlstand_bridge::vehicle::{FIELDS, Port, Vehicle};
use whirlstand_bridge::{crsf, sbus};

use crate::support::{self, Pair, config, mavlink};

/// All fields of the bus, in the order of [`FIELDS`], after a message.
fn measured(vehicle: &mut Vehicle) -> [f64; FIELDS.len()] {
    let (imu, odometry) = vehicle.measure();
    [
        imu.roll,
        imu.pitch,
        imu.yaw,
        imu.roll_rate,
        imu.pitch_rate,
        imu.yaw_rate,
        odometry.longitudinal_position,
        odometry.lateral_position,
        odometry.height,
        odometry.longitudinal_speed,
        odometry.lateral_speed,
        odometry.vertical_speed,
    ]
}

/// Asserts that `field` alone is `value`.
#[track_caller]
fn alone(found: [f64; FIELDS.len()], field: &str, value: f64) {
    for (name, found) in FIELDS.iter().zip(found) {
        let wanted = if *name == field { value } else { 0.0 };
        assert!((found - wanted).abs() < 1e-6, "{field} was {value}, and {name} is {found}");
    }
}

/// What a bridge with these options measures after a message.
fn heard(options: &str, message: impl Fn(u32) -> MavMessage) -> [f64; FIELDS.len()] {
    let mut config = config();
    config.options.mavlink = Some(mavlink(&format!(r#"{{"link": "udpin://127.0.0.1:1"{options}}}"#)));
    let mut pair = Pair::new(&config);
    pair.say(&pair.heartbeat());
    pair.now += Duration::from_millis(5);
    pair.say(&message((pair.now + pair.boot).as_millis() as u32));
    measured(&mut pair.vehicle)
}

const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
const RATES: [&str; 3] = ["roll_rate", "pitch_rate", "yaw_rate"];
const BOTH_WAYS: [f32; 2] = [0.25, -0.25];

#[test]
fn every_angle_and_rate_of_mavlink_arrives_alone_with_its_sign() {
    for axis in 0..3 {
        for size in BOTH_WAYS {
            let mut v = [0.0; 3];
            v[axis] = size;
            let wanted = f64::from(size);
            let [roll, pitch, yaw] = v;
            let found = heard("", |time_boot_ms| {
                MavMessage::ATTITUDE(dialect::ATTITUDE_DATA {
                    time_boot_ms,
                    roll,
                    pitch,
                    yaw,
                    ..Default::default()
                })
            });
            alone(found, ANGLES[axis], wanted);
            let found = heard("", |time_boot_ms| {
                let [rollspeed, pitchspeed, yawspeed] = v;
                let data = dialect::ATTITUDE_DATA {
                    time_boot_ms,
                    rollspeed,
                    pitchspeed,
                    yawspeed,
                    ..Default::default()
                };
                MavMessage::ATTITUDE(data)
            });
            alone(found, RATES[axis], wanted);
            let found = heard(r#", "attitude": "quaternion""#, |time_boot_ms| {
                let (sin, q1) = (size / 2.0).sin_cos();
                let [q2, q3, q4] = v.map(|v| sin * v / size);
                let data =
                    dialect::ATTITUDE_QUATERNION_DATA { time_boot_ms, q1, q2, q3, q4, ..Default::default() };
                MavMessage::ATTITUDE_QUATERNION(data)
            });
            alone(found, ANGLES[axis], wanted);
        }
    }
}

#[test]
fn every_rate_of_an_imu_arrives_alone_in_its_unit() {
    let options = r#", "rates": "imu""#;
    for axis in 0..3 {
        for size in BOTH_WAYS {
            let mut v = [0.0; 3];
            v[axis] = size;
            let [xgyro, ygyro, zgyro] = v;
            let found = heard(options, |ms| {
                let time_usec = u64::from(ms) * 1000;
                let data = dialect::HIGHRES_IMU_DATA { time_usec, xgyro, ygyro, zgyro, ..Default::default() };
                MavMessage::HIGHRES_IMU(data)
            });
            alone(found, RATES[axis], f64::from(size));
            // Thousandths of rad/s.
            let [xgyro, ygyro, zgyro] = v.map(|v| (v * 1000.0) as i16);
            type Imu = fn(u32, [i16; 3]) -> MavMessage;
            let imus: [Imu; 3] = [
                |time_boot_ms, [xgyro, ygyro, zgyro]| {
                    let data =
                        dialect::SCALED_IMU_DATA { time_boot_ms, xgyro, ygyro, zgyro, ..Default::default() };
                    MavMessage::SCALED_IMU(data)
                },
                |time_boot_ms, [xgyro, ygyro, zgyro]| {
                    let data =
                        dialect::SCALED_IMU2_DATA { time_boot_ms, xgyro, ygyro, zgyro, ..Default::default() };
                    MavMessage::SCALED_IMU2(data)
                },
                |time_boot_ms, [xgyro, ygyro, zgyro]| {
                    let data =
                        dialect::SCALED_IMU3_DATA { time_boot_ms, xgyro, ygyro, zgyro, ..Default::default() };
                    MavMessage::SCALED_IMU3(data)
                },
            ];
            for imu in imus {
                let found = heard(options, |ms| imu(ms, [xgyro, ygyro, zgyro]));
                alone(found, RATES[axis], f64::from(size));
            }
        }
    }
}

#[test]
fn every_position_and_speed_arrives_alone_along_the_heading() {
    let quarter = std::f64::consts::FRAC_PI_2;
    // Forward, right, up, in north, east, down.
    for (heading, axes) in [
        (0.0, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
        (quarter, [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
    ] {
        for (axis, ned) in axes.into_iter().enumerate() {
            for size in BOTH_WAYS {
                let mut config = config();
                let options = format!(r#"{{"link": "udpin://127.0.0.1:1", "heading": {heading}}}"#);
                config.options.mavlink = Some(mavlink(&options));
                let mut pair = Pair::new(&config);
                pair.say(&pair.heartbeat());
                let mut at = |place: [f32; 3], speed: [f32; 3]| {
                    pair.now += Duration::from_millis(5);
                    let time_boot_ms = (pair.now + pair.boot).as_millis() as u32;
                    // The first place is the origin, wherever it is.
                    let [x, y, z] = [place[0] + 3.0, place[1] - 7.0, place[2] - 20.0];
                    let [vx, vy, vz] = speed;
                    let data = dialect::LOCAL_POSITION_NED_DATA { time_boot_ms, x, y, z, vx, vy, vz };
                    pair.say(&MavMessage::LOCAL_POSITION_NED(data));
                    measured(&mut pair.vehicle)
                };
                at([0.0; 3], [0.0; 3]);
                let moved = ned.map(|v: f32| v * size);
                let found = at(moved, [0.0; 3]);
                alone(found, ["longitudinal_position", "lateral_position", "height"][axis], f64::from(size));
                let found = at([0.0; 3], moved);
                alone(
                    found,
                    ["longitudinal_speed", "lateral_speed", "vertical_speed"][axis],
                    f64::from(size),
                );
            }
        }
    }
}

/// A bridge to a CRSF module that arms as soon as all is well.
fn crsf_config() -> BridgeConfig {
    let mut config = config();
    config.kind = BridgeKind::Crsf;
    config.options.safety.arm = ArmBy::Start;
    config.options.crsf = serde_json::from_str(r#"{"link": "serial:///dev/x:420000"}"#).unwrap();
    config
}

#[test]
fn every_angle_of_crsf_arrives_alone_with_its_sign() {
    for axis in 0..3 {
        for size in [0.25, -0.25] {
            let mut vehicle = Vehicle::new(&crsf_config(), support::bench()).unwrap();
            let mut angles = [0.0; 3];
            angles[axis] = size;
            let [roll, pitch, yaw] = angles;
            let mut bytes = Vec::new();
            crsf::write_attitude(&crsf::Attitude { roll, pitch, yaw }, &mut bytes);
            vehicle.receive(Port::Link, &bytes, false, Duration::from_secs(1));
            alone(measured(&mut vehicle), ANGLES[axis], size);
        }
    }
}

/// The last of what flies out of a MAVLink bridge with this output under commands `u`, and what went to its line.
fn sent(output: &str, u: [f64; 2]) -> (Vec<MavMessage>, Vec<u8>) {
    let mut config = config();
    let options = format!(
        r#"{{"link": "udpin://127.0.0.1:1", "output": "{output}", "output_link": "serial:///dev/x:420000",
            "attitude_target": {{"kind": "rates", "full": 2.0}}}}"#
    );
    let mut own = mavlink(&options);
    if !["crsf", "sbus"].contains(&output) {
        own.output_link = None;
    }
    config.options.mavlink = Some(own);
    let mut pair = Pair::new(&config);
    pair.armed = true;
    for _ in 0..20 {
        pair.vehicle.output(Port::Output).clear();
        pair.step(u);
    }
    assert_eq!(pair.vehicle.mode(), Mode::Automatic);
    (pair.heard, std::mem::take(pair.vehicle.output(Port::Output)))
}

/// Roll and pitch as they left through each output, as a share of full.
fn shares(output: &str, u: [f64; 2]) -> [f64; 2] {
    let (heard, line) = sent(output, u);
    let us = |channels: [u16; 16], us: fn(u16) -> f64| {
        // Throttle and yaw rest in the middle, channel 5 arms, and the others are low.
        let rests = channels[2] == channels[3] && channels[5..].iter().all(|c| *c == channels[15]);
        assert!(rests && channels[15] < channels[2] && channels[2] < channels[4], "{channels:?}");
        [channels[0], channels[1]].map(|c| (us(c) - 1500.0) / 500.0)
    };
    match output {
        "crsf" => {
            let mut parser = crsf::Parser::new();
            parser.push(&line);
            let Some(crsf::Event::Channels(c)) = std::iter::from_fn(|| parser.next_event()).last() else {
                panic!()
            };
            us(c.0, crsf::us_of_ticks)
        }
        "sbus" => {
            let mut parser = sbus::Parser::new();
            parser.push(&line);
            us(std::iter::from_fn(|| parser.next_frame()).last().unwrap().channels, sbus::us_of_ticks)
        }
        _ => {
            let share = |m: &MavMessage| match m {
                MavMessage::RC_CHANNELS_OVERRIDE(m) => {
                    assert_eq!([m.chan3_raw, m.chan4_raw, m.chan5_raw, m.chan16_raw], [u16::MAX; 4]);
                    Some([m.chan1_raw, m.chan2_raw].map(|us| (f64::from(us) - 1500.0) / 500.0))
                }
                MavMessage::MANUAL_CONTROL(m) => {
                    assert_eq!([m.z, m.r], [i16::MAX; 2], "nobody moves these");
                    Some([f64::from(m.y) / 1000.0, f64::from(m.x) / -1000.0])
                }
                MavMessage::SET_ATTITUDE_TARGET(m) => {
                    assert_eq!(m.body_yaw_rate, 0.0);
                    Some([m.body_roll_rate, m.body_pitch_rate].map(|r| f64::from(r) / 2.0))
                }
                _ => None,
            };
            heard.iter().rev().find_map(share).unwrap()
        }
    }
}

#[test]
fn every_input_leaves_alone_with_its_sign_through_every_output() {
    for output in ["rc-override", "manual-control", "attitude-target", "crsf", "sbus"] {
        for axis in 0..2 {
            for size in [8.0, -8.0] {
                let mut u = [0.0; 2];
                u[axis] = size;
                let found = shares(output, u);
                for (i, found) in found.into_iter().enumerate() {
                    let wanted = if i == axis { size / support::FULL } else { 0.0 };
                    // A tick of CRSF or SBUS is 0.6 us of 500.
                    assert!((found - wanted).abs() < 2e-3, "{output}, axis {axis}: {found} is not {wanted}");
                }
            }
        }
    }
}
