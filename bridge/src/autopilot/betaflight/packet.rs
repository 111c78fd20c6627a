//! Betaflight's packets.

use std::f64::consts::{FRAC_PI_2, PI};
use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::autopilot::RC_CHANNELS;
use crate::sensors::Sensors;

/// Length of `fdm_packet`.
pub const FDM_BYTES: usize = 144;
/// Length of `rc_packet`.
pub const RC_BYTES: usize = 40;
/// Length of `servo_packet`.
const MOTORS_BYTES: usize = 16;
/// Length of `servo_packet_raw`.
const RAW_BYTES: usize = 68;
/// Largest number of outputs in `servo_packet_raw`.
const RAW_OUTPUTS: usize = 16;

/// Valid range of motor outputs, with a margin for rounding.
const MOTOR_RANGE: std::ops::RangeInclusive<f64> = -0.001..=1.001;
/// Valid range of pulses, us; zero means an unused output.
const PULSES: std::ops::RangeInclusive<f64> = 500.0..=2500.0;

/// Format of state packets: Betaflight reads one of two, fixed when it is compiled.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Flavour {
    /// Format of Gazebo's plugin; Betaflight's default.
    #[default]
    Gazebo,
    /// Format of the bridges to X-Plane and RealFlight (`ENABLE_GAZEBO_BRIDGE=0`, and every release before
    /// 2025.12).
    Legacy,
}

/// Reason why bytes are not a packet of Betaflight.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PacketError {
    /// Betaflight sends nothing on this port.
    #[error("a packet arrived at a port to which Betaflight sends nothing")]
    Port,
    /// The length is wrong.
    #[error("{found} bytes arrived where {expected} are expected")]
    Length {
        /// Bytes received.
        found: usize,
        /// Length of the packet in bytes.
        expected: usize,
    },
    /// The number of motors exceeds the packet.
    #[error("the packet says that it holds {0} motors: at most 16 are expected")]
    Count(u16),
    /// A value is out of range.
    #[error("output {output} is {value}: {expected} is expected")]
    Value {
        /// Output number, from 1.
        output: usize,
        /// Received value.
        value: f64,
        /// Description of the valid range.
        expected: &'static str,
    },
}

/// Pulses of `servo_packet_raw`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Raw {
    values: [f64; RAW_OUTPUTS],
}

impl Raw {
    /// Motors, then servos, us; zero for unused outputs.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

fn sized(bytes: &[u8], expected: usize) -> Result<(), PacketError> {
    if bytes.len() == expected { Ok(()) } else { Err(PacketError::Length { found: bytes.len(), expected }) }
}

fn floats(bytes: &[u8]) -> impl Iterator<Item = f64> + '_ {
    bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b)))
}

/// Decodes `servo_packet`: four motors, 0 to 1.
///
/// # Errors
/// [`PacketError`] for another length, or a value that is not finite or out of range.
pub fn parse_motors(bytes: &[u8]) -> Result<[f64; 4], PacketError> {
    sized(bytes, MOTORS_BYTES)?;
    let mut motors = [0.0; 4];
    for (i, (motor, value)) in motors.iter_mut().zip(floats(bytes)).enumerate() {
        if !MOTOR_RANGE.contains(&value) {
            return Err(PacketError::Value { output: i + 1, value, expected: "0 to 1" });
        }
        *motor = value.clamp(0.0, 1.0);
    }
    Ok(motors)
}

/// Decodes `servo_packet_raw`: pulses in us.
///
/// # Errors
/// [`PacketError`] for another length, too many motors, or a value out of the range of pulses.
pub fn parse_raw(bytes: &[u8]) -> Result<Raw, PacketError> {
    sized(bytes, RAW_BYTES)?;
    let count = u16::from_le_bytes([bytes[0], bytes[1]]);
    if usize::from(count) > RAW_OUTPUTS {
        return Err(PacketError::Count(count));
    }
    let mut values = [0.0; RAW_OUTPUTS];
    for (i, (slot, value)) in values.iter_mut().zip(floats(&bytes[4..])).enumerate() {
        if value != 0.0 && !PULSES.contains(&value) {
            return Err(PacketError::Value { output: i + 1, value, expected: "0 or 500 to 2500 us" });
        }
        *slot = value;
    }
    Ok(Raw { values })
}

/// Encodes `servo_packet_raw`, as Betaflight sends it.
pub fn raw_bytes(count: u16, pulses: &[f32; RAW_OUTPUTS]) -> [u8; RAW_BYTES] {
    let mut bytes = [0; RAW_BYTES];
    bytes[..2].copy_from_slice(&count.to_le_bytes());
    for (slot, pulse) in bytes[4..].as_chunks_mut::<4>().0.iter_mut().zip(pulses) {
        *slot = pulse.to_le_bytes();
    }
    bytes
}

/// Encodes `rc_packet`: time in s, pulses in us.
pub(super) fn channels(now: Duration, pulses: &[u16; RC_CHANNELS]) -> [u8; RC_BYTES] {
    let mut bytes = [0; RC_BYTES];
    bytes[..8].copy_from_slice(&now.as_secs_f64().to_le_bytes());
    for (slot, pulse) in bytes[8..].as_chunks_mut::<2>().0.iter_mut().zip(pulses) {
        *slot = pulse.to_le_bytes();
    }
    bytes
}

/// Time in every state packet, s. Betaflight refuses a packet older than the previous one: with a constant
/// time a restarted bridge can continue.
const TOLD_TIME: f64 = 0.0;

/// Encodes `fdm_packet`: time in s, [`TOLD_TIME`]; turn rate in rad/s; specific force in m/s^2, backward,
/// right, down; attitude, real part first; velocity in m/s, east, north, up; longitude and latitude in
/// degrees, height in m; pressure in Pa.
pub(super) fn state(s: &Sensors, flavour: Flavour, origin: (f64, f64)) -> [u8; FDM_BYTES] {
    let (gyro, attitude) = (gyro(s, flavour), attitude(s, flavour));
    let (latitude, longitude) = match flavour {
        Flavour::Legacy => (s.gps.latitude, s.gps.longitude),
        // Gazebo sends positions mirrored about the origin, and Betaflight mirrors them back about the first
        // one.
        Flavour::Gazebo => (2.0 * origin.0 - s.gps.latitude, 2.0 * origin.1 - s.gps.longitude),
    };
    let v = s.gps.velocity;
    let fields: [f64; 18] = [
        TOLD_TIME,
        gyro.x,
        gyro.y,
        gyro.z,
        // Betaflight negates all three, and uses the result as forward, left, up.
        -s.accel.x,
        s.accel.y,
        s.accel.z,
        attitude.w,
        attitude.i,
        attitude.j,
        attitude.k,
        v.y,
        v.x,
        -v.z,
        longitude,
        latitude,
        s.gps.altitude,
        s.pressure,
    ];
    let mut bytes = [0; FDM_BYTES];
    for (slot, field) in bytes.as_chunks_mut::<8>().0.iter_mut().zip(fields) {
        *slot = field.to_le_bytes();
    }
    bytes
}

/// Turn rate as Betaflight expects it. Its internal rates are about forward, left and up: its attitude, its
/// yaw stick and its mixer use these. It negates pitch and, from legacy bridges, yaw; yaw from Gazebo it uses
/// unchanged.
fn gyro(s: &Sensors, flavour: Flavour) -> Vector3<f64> {
    match flavour {
        Flavour::Gazebo => Vector3::new(s.gyro.x, s.gyro.y, -s.gyro.z),
        Flavour::Legacy => s.gyro,
    }
}

/// Attitude as Betaflight expects it. From legacy bridges Betaflight uses the given attitude, of the body
/// forward, right, down over north, east, down: it changes the sign of two matrix entries back itself
/// (`imuComputeRotationMatrix`). From Gazebo's plugin it removes half a turn about x on either side, then
/// adds a quarter turn about up, for forward, left, up over north, west, up.
fn attitude(s: &Sensors, flavour: Flavour) -> nalgebra::Quaternion<f64> {
    let q = match flavour {
        Flavour::Legacy => s.attitude,
        Flavour::Gazebo => {
            let half = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
            let quarter_back = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -FRAC_PI_2);
            // Half a turn about x transforms north, east, down to north, west, up, and forward, right, down
            // to forward, left, up.
            let inside = half * s.attitude * half;
            half * quarter_back * inside * half
        }
    };
    // Half turns change the sign; Betaflight assumes a positive quaternion.
    if q.w < 0.0 { -q.into_inner() } else { q.into_inner() }
}
