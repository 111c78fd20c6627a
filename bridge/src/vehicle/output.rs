//! Encodes channels in the message of each kind of output.

use std::time::Duration;

use crate::channels::CHANNELS;
use crate::config::{AttitudeTarget, TargetKind};
use crate::crsf;
use crate::mavlink::{MavMessage, dialect};
use crate::sbus;

/// Value of `RC_CHANNELS_OVERRIDE` that leaves a channel unchanged.
const IGNORE: u16 = u16::MAX;
/// Value of `RC_CHANNELS_OVERRIDE` that returns a channel to the radio, for channels 9 and up.
const RELEASE_HIGH: u16 = u16::MAX - 1;

/// Override of the channels in use; `None` returns them to the vehicle's own radio.
pub(super) fn rc_override(
    us: Option<&[f64; CHANNELS]>,
    in_use: &[bool; CHANNELS],
    (target_system, target_component): (u8, u8),
) -> MavMessage {
    let raw = |i: usize| match us {
        _ if !in_use[i] => IGNORE,
        // From 800 to 2200: rounding cannot leave the range.
        Some(us) => us[i].round() as u16,
        None if i < 8 => 0,
        None => RELEASE_HIGH,
    };
    MavMessage::RC_CHANNELS_OVERRIDE(dialect::RC_CHANNELS_OVERRIDE_DATA {
        target_system,
        target_component,
        chan1_raw: raw(0),
        chan2_raw: raw(1),
        chan3_raw: raw(2),
        chan4_raw: raw(3),
        chan5_raw: raw(4),
        chan6_raw: raw(5),
        chan7_raw: raw(6),
        chan8_raw: raw(7),
        chan9_raw: raw(8),
        chan10_raw: raw(9),
        chan11_raw: raw(10),
        chan12_raw: raw(11),
        chan13_raw: raw(12),
        chan14_raw: raw(13),
        chan15_raw: raw(14),
        chan16_raw: raw(15),
        chan17_raw: IGNORE,
        chan18_raw: IGNORE,
    })
}

/// Stick positions from channels 1 to 4: x forward, so nose down is positive; y right; z 0 to 1000; r
/// clockwise.
pub(super) fn manual_control(us: &[f64; CHANNELS], in_use: &[bool; CHANNELS], target: u8) -> MavMessage {
    let stick = |i: usize, value: f64| if in_use[i] { value.round() as i16 } else { i16::MAX };
    MavMessage::MANUAL_CONTROL(dialect::MANUAL_CONTROL_DATA {
        target,
        x: stick(1, -normal(us[1]) * 1000.0),
        y: stick(0, normal(us[0]) * 1000.0),
        z: stick(2, thrust(us[2]) * 1000.0),
        r: stick(3, normal(us[3]) * 1000.0),
        ..Default::default()
    })
}

/// Attitude or body rates from channels 1 to 4: roll, pitch, thrust, yaw rate.
pub(super) fn attitude_target(
    us: &[f64; CHANNELS],
    in_use: &[bool; CHANNELS],
    meaning: &AttitudeTarget,
    yaw: f64,
    (target_system, target_component): (u8, u8),
    now: Duration,
) -> MavMessage {
    let (roll, pitch) = (normal(us[0]) * meaning.full, normal(us[1]) * meaning.full);
    let yaw_rate = if in_use[3] { normal(us[3]) * meaning.full_yaw_rate } else { 0.0 };
    use dialect::AttitudeTargetTypemask as Mask;
    let (q, rates, mut mask) = match meaning.kind {
        TargetKind::Rates => {
            ([1.0, 0.0, 0.0, 0.0], [roll, pitch], Mask::ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE)
        }
        TargetKind::Angles => (
            quaternion(roll, pitch, yaw),
            [0.0, 0.0],
            Mask::ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
                | Mask::ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE,
        ),
    };
    if !in_use[2] {
        mask |= Mask::ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE;
    }
    MavMessage::SET_ATTITUDE_TARGET(dialect::SET_ATTITUDE_TARGET_DATA {
        time_boot_ms: (now.as_millis() & 0xFFFF_FFFF) as u32,
        target_system,
        target_component,
        type_mask: mask,
        q: q.map(|v| v as f32),
        body_roll_rate: rates[0] as f32,
        body_pitch_rate: rates[1] as f32,
        body_yaw_rate: yaw_rate as f32,
        thrust: thrust(us[2]) as f32,
        ..Default::default()
    })
}

/// Appends a CRSF frame of all channels.
pub(super) fn crsf(us: &[f64; CHANNELS], out: &mut Vec<u8>) {
    crsf::write_channels(&crsf::Channels(us.map(crsf::ticks_of_us)), out);
}

/// Appends an SBUS frame of all channels.
pub(super) fn sbus(us: &[f64; CHANNELS], out: &mut Vec<u8>) {
    let channels = us.map(sbus::ticks_of_us);
    sbus::write(&sbus::Frame { channels, digital: [false; 2], lost: false, failsafe: false }, out);
}

/// Normalised value, -1 to 1 for 1000 to 2000 us.
fn normal(us: f64) -> f64 {
    ((us - 1500.0) / 500.0).clamp(-1.0, 1.0)
}

/// Thrust, 0 to 1 for 1000 to 2000 us.
fn thrust(us: f64) -> f64 {
    ((us - 1000.0) / 1000.0).clamp(0.0, 1.0)
}

/// The quaternion (w, x, y, z) of roll, pitch and yaw, rotations about x, y, z in the order yaw, pitch, roll.
pub(super) fn quaternion(roll: f64, pitch: f64, yaw: f64) -> [f64; 4] {
    let ((sr, cr), (sp, cp), (sy, cy)) =
        ((roll / 2.0).sin_cos(), (pitch / 2.0).sin_cos(), (yaw / 2.0).sin_cos());
    [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
}

/// Roll, pitch and yaw of a quaternion (w, x, y, z), which need not be normalised; `None` for a zero
/// quaternion.
pub(super) fn euler([w, x, y, z]: [f64; 4]) -> Option<[f64; 3]> {
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    if !(norm > 1e-6 && norm.is_finite()) {
        return None;
    }
    let [w, x, y, z] = [w, x, y, z].map(|v| v / norm);
    let roll = (2.0 * (w * x + y * z)).atan2(1.0 - 2.0 * (x * x + y * y));
    let pitch = (2.0 * (w * y - z * x)).clamp(-1.0, 1.0).asin();
    let yaw = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    Some([roll, pitch, yaw])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const IN_USE: [bool; CHANNELS] = {
        let mut in_use = [false; CHANNELS];
        (in_use[0], in_use[1], in_use[2], in_use[8]) = (true, true, true, true);
        in_use
    };

    fn us(roll: f64, pitch: f64, throttle: f64) -> [f64; CHANNELS] {
        let mut us = [1500.0; CHANNELS];
        (us[0], us[1], us[2]) = (roll, pitch, throttle);
        us
    }

    #[test]
    fn the_override_moves_its_channels_and_gives_them_back() {
        let MavMessage::RC_CHANNELS_OVERRIDE(m) =
            rc_override(Some(&us(1600.4, 1400.0, 1000.0)), &IN_USE, (1, 2))
        else {
            panic!()
        };
        assert_eq!((m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw), (1600, 1400, 1000, u16::MAX));
        assert_eq!((m.chan9_raw, m.chan10_raw, m.chan17_raw), (1500, u16::MAX, u16::MAX));
        let MavMessage::RC_CHANNELS_OVERRIDE(m) = rc_override(None, &IN_USE, (1, 2)) else { panic!() };
        assert_eq!((m.chan1_raw, m.chan4_raw, m.chan9_raw), (0, u16::MAX, u16::MAX - 1));
    }

    #[test]
    fn each_stick_moves_its_axis_alone_with_its_sign() {
        for (us, want) in [
            (us(1750.0, 1500.0, 1000.0), (0, 500, 0)),
            (us(1250.0, 1500.0, 1000.0), (0, -500, 0)),
            (us(1500.0, 1750.0, 1000.0), (-500, 0, 0)),
            (us(1500.0, 1250.0, 1000.0), (500, 0, 0)),
            (us(1500.0, 1500.0, 1600.0), (0, 0, 600)),
        ] {
            let MavMessage::MANUAL_CONTROL(m) = manual_control(&us, &IN_USE, 1) else { panic!() };
            assert_eq!((m.x, m.y, m.z, m.r), (want.0, want.1, want.2, i16::MAX));
        }
    }

    #[test]
    fn attitude_targets_are_rates_or_angles() {
        let rates = AttitudeTarget { kind: TargetKind::Rates, full: 2.0, full_yaw_rate: 1.0 };
        let now = Duration::from_millis(1234);
        let MavMessage::SET_ATTITUDE_TARGET(m) =
            attitude_target(&us(1750.0, 1250.0, 1500.0), &IN_USE, &rates, 0.0, (1, 1), now)
        else {
            panic!()
        };
        assert_eq!((m.body_roll_rate, m.body_pitch_rate, m.body_yaw_rate, m.thrust), (1.0, -1.0, 0.0, 0.5));
        assert_eq!((m.type_mask.bits(), m.time_boot_ms), (128, 1234));
        let angles = AttitudeTarget { kind: TargetKind::Angles, full: 0.5, full_yaw_rate: 1.0 };
        let MavMessage::SET_ATTITUDE_TARGET(m) =
            attitude_target(&us(1750.0, 1500.0, 1500.0), &IN_USE, &angles, 1.0, (1, 1), now)
        else {
            panic!()
        };
        let [roll, pitch, yaw] = euler(m.q.map(f64::from)).unwrap();
        assert!((roll - 0.25).abs() < 1e-6 && pitch.abs() < 1e-6 && (yaw - 1.0).abs() < 1e-6);
        assert_eq!(m.type_mask.bits(), 3);
    }

    #[test]
    fn an_angle_target_follows_each_stick_alone_with_its_sign() {
        let angles = AttitudeTarget { kind: TargetKind::Angles, full: 0.5, full_yaw_rate: 1.0 };
        for (pulses, want) in [
            (us(1500.0, 1750.0, 1500.0), [0.0, 0.25]),
            (us(1500.0, 1000.0, 1500.0), [0.0, -0.5]),
            (us(1250.0, 1750.0, 1500.0), [-0.25, 0.25]),
        ] {
            for yaw in [0.0, 1.0, -2.0] {
                let MavMessage::SET_ATTITUDE_TARGET(m) =
                    attitude_target(&pulses, &IN_USE, &angles, yaw, (1, 1), Duration::ZERO)
                else {
                    panic!()
                };
                let [roll, pitch, heading] = euler(m.q.map(f64::from)).unwrap();
                let off = [roll - want[0], pitch - want[1], heading - yaw];
                assert!(off.iter().all(|d| d.abs() < 1e-6), "{pulses:?}, {yaw}: {off:?}");
                assert_eq!((m.body_roll_rate, m.body_pitch_rate), (0.0, 0.0));
            }
        }
        // Nose up is a positive rotation about the axis to the right.
        let MavMessage::SET_ATTITUDE_TARGET(m) =
            attitude_target(&us(1500.0, 2000.0, 1500.0), &IN_USE, &angles, 0.0, (1, 1), Duration::ZERO)
        else {
            panic!()
        };
        assert!((m.q[2] - 0.25f32.sin()).abs() < 1e-6 && m.q[1] == 0.0 && m.q[3] == 0.0, "{:?}", m.q);
    }

    proptest! {
        #[test]
        fn angles_survive_the_quaternion(roll in -3.1..3.1f64, pitch in -1.5..1.5f64, yaw in -3.1..3.1f64, length in 0.1..9f64) {
            let q = quaternion(roll, pitch, yaw).map(|v| v * length);
            let back = euler(q).unwrap();
            for (a, b) in back.iter().zip([roll, pitch, yaw]) {
                prop_assert!((a - b).abs() < 1e-9);
            }
        }
    }
}
