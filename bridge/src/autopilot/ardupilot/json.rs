//! The JSON line read by ArduPilot.
//!
//! ArduPilot's reader searches for keys in the text, requires that no blank follows a colon, and uses the
//! last line that has a line feed on both sides.

use std::fmt::Write as _;

use nalgebra::Vector3;

use crate::sensors::Sensors;

/// Writes the line into `out`. Time in s; gyro rad/s, FRD; specific force m/s^2, FRD; position m, NED from
/// home; attitude as quaternion from body to earth, real part first; velocity m/s, NED; airspeed m/s.
pub(super) fn line(s: &Sensors, time_ns: u64, out: &mut String) {
    out.clear();
    let list = |v: &Vector3<f64>| format!("[{},{},{}]", v.x, v.y, v.z);
    let q = s.attitude.quaternion();
    // Writing to a String is infallible.
    let _ = write!(
        out,
        "\n{{\"timestamp\":{}.{:09},\"imu\":{{\"gyro\":{},\"accel_body\":{}}},\"position\":{},\
         \"quaternion\":[{},{},{},{}],\"velocity\":{},\"airspeed\":{}}}\n",
        time_ns / 1_000_000_000,
        time_ns % 1_000_000_000,
        list(&s.gyro),
        list(&s.accel),
        list(&s.position),
        q.w,
        q.i,
        q.j,
        q.k,
        list(&s.velocity),
        s.velocity.norm(),
    );
}
