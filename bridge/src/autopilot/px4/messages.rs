//! Sensors as MAVLink messages to PX4.

use crate::autopilot::RC_CHANNELS;
use crate::mavlink::MavMessage;
use crate::mavlink::dialect::{
    HIL_GPS_DATA, HIL_SENSOR_DATA, HIL_STATE_QUATERNION_DATA, HilSensorUpdatedFlags, RC_CHANNELS_DATA,
};
use crate::sensors::{STANDARD_GRAVITY, Sensors};

/// PX4 treats a time of zero as missing, so its clock starts here, us.
const CLOCK_START_US: u64 = 1_000_000;

/// Zero degrees Celsius, K.
const FREEZING: f64 = 273.15;

/// Bits of HIL_SENSOR's `fields_updated`: all bits of a group are set or none.
const ACCEL: u32 = 0x7;
const GYRO: u32 = 0x38;
const MAG: u32 = 0x1C0;
const BARO: u32 = 0x1A00;
const DIFFERENTIAL_PRESSURE: u32 = 0x400;

/// Sensor time in PX4's clock, us.
pub(super) fn microseconds(time_ns: u64) -> u64 {
    CLOCK_START_US + time_ns / 1000
}

/// HIL_SENSOR: accelerometer m/s^2 and gyroscope rad/s, FRD; magnetometer in gauss, FRD; pressures in hPa;
/// height in m; temperature in degrees Celsius.
pub(super) fn sensor(s: &Sensors, mag: bool, baro: bool, airspeed: bool) -> MavMessage {
    let mut fields = ACCEL | GYRO;
    for (present, bits) in [(mag, MAG), (baro, BARO), (airspeed, DIFFERENTIAL_PRESSURE)] {
        fields |= if present { bits } else { 0 };
    }
    MavMessage::HIL_SENSOR(HIL_SENSOR_DATA {
        time_usec: microseconds(s.time_ns),
        xacc: s.accel.x as f32,
        yacc: s.accel.y as f32,
        zacc: s.accel.z as f32,
        xgyro: s.gyro.x as f32,
        ygyro: s.gyro.y as f32,
        zgyro: s.gyro.z as f32,
        xmag: (s.mag.x * 1e4) as f32,
        ymag: (s.mag.y * 1e4) as f32,
        zmag: (s.mag.z * 1e4) as f32,
        abs_pressure: (s.pressure * 1e-2) as f32,
        diff_pressure: (s.differential_pressure * 1e-2) as f32,
        pressure_alt: s.pressure_altitude as f32,
        temperature: (s.temperature - FREEZING) as f32,
        fields_updated: HilSensorUpdatedFlags::from_bits_retain(fields),
        id: 0,
    })
}

/// Lowest speed at which a receiver can determine the course, m/s.
const SLOWEST: f64 = 0.1;

/// HIL_GPS: degrees x 1e7, mm, cm/s, hundredths of a degree; `vel` is over ground, and 65535 an unknown
/// course. PX4 reads `eph` and `epv` as standard deviations in cm.
pub(super) fn gps(s: &Sensors) -> MavMessage {
    let fix = &s.gps;
    let speed = fix.velocity.x.hypot(fix.velocity.y);
    let course = fix.velocity.y.atan2(fix.velocity.x).to_degrees().rem_euclid(360.0);
    MavMessage::HIL_GPS(HIL_GPS_DATA {
        time_usec: microseconds(s.time_ns),
        lat: (fix.latitude * 1e7).round() as i32,
        lon: (fix.longitude * 1e7).round() as i32,
        alt: (fix.altitude * 1e3).round() as i32,
        eph: 30,
        epv: 40,
        vel: (speed * 1e2).round() as u16,
        vn: (fix.velocity.x * 1e2).round() as i16,
        ve: (fix.velocity.y * 1e2).round() as i16,
        vd: (fix.velocity.z * 1e2).round() as i16,
        cog: if speed < SLOWEST { u16::MAX } else { (course * 1e2) as u16 },
        fix_type: 3,
        satellites_visible: 12,
        id: 0,
        yaw: 0,
    })
}

/// HIL_STATE_QUATERNION, the true state: attitude real part first; rad/s; degrees x 1e7, mm; cm/s NED;
/// acceleration over ground in thousandths of g, FRD.
pub(super) fn state(s: &Sensors) -> MavMessage {
    let q = s.attitude.quaternion();
    let acceleration = s.attitude.inverse_transform_vector(&s.acceleration) / STANDARD_GRAVITY;
    let airspeed = (s.velocity.norm() * 1e2).round() as u16;
    MavMessage::HIL_STATE_QUATERNION(HIL_STATE_QUATERNION_DATA {
        time_usec: microseconds(s.time_ns),
        attitude_quaternion: [q.w as f32, q.i as f32, q.j as f32, q.k as f32],
        rollspeed: s.turn.x as f32,
        pitchspeed: s.turn.y as f32,
        yawspeed: s.turn.z as f32,
        lat: (s.latitude * 1e7).round() as i32,
        lon: (s.longitude * 1e7).round() as i32,
        alt: (s.altitude * 1e3).round() as i32,
        vx: (s.velocity.x * 1e2).round() as i16,
        vy: (s.velocity.y * 1e2).round() as i16,
        vz: (s.velocity.z * 1e2).round() as i16,
        ind_airspeed: airspeed,
        true_airspeed: airspeed,
        xacc: (acceleration.x * 1e3).round() as i16,
        yacc: (acceleration.y * 1e3).round() as i16,
        zacc: (acceleration.z * 1e3).round() as i16,
    })
}

/// RC_CHANNELS: pulses in us, full signal strength.
pub(super) fn channels(s: &Sensors, p: &[u16; RC_CHANNELS]) -> MavMessage {
    MavMessage::RC_CHANNELS(RC_CHANNELS_DATA {
        time_boot_ms: (microseconds(s.time_ns) / 1000) as u32,
        chan1_raw: p[0],
        chan2_raw: p[1],
        chan3_raw: p[2],
        chan4_raw: p[3],
        chan5_raw: p[4],
        chan6_raw: p[5],
        chan7_raw: p[6],
        chan8_raw: p[7],
        chan9_raw: p[8],
        chan10_raw: p[9],
        chan11_raw: p[10],
        chan12_raw: p[11],
        chan13_raw: p[12],
        chan14_raw: p[13],
        chan15_raw: p[14],
        chan16_raw: p[15],
        chan17_raw: u16::MAX,
        chan18_raw: u16::MAX,
        chancount: RC_CHANNELS as u8,
        rssi: 254,
    })
}
