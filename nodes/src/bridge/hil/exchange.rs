//! Exchange with an autopilot, for the log.

use whirlstand_bridge::autopilot::{Outputs, RC_CHANNELS};
use whirlstand_bridge::sensors::Sensors;
use whirlstand_msgs::{Autopilot, MAX_OUTPUTS, Message, armed};

use super::state::Fault;

/// Log message of the sensors and pilot's channels sent, and of the outputs in use; `None` where there are
/// none. The caller fills in the head.
pub(super) fn exchange(
    sensors: Option<&Sensors>,
    rc: [u16; RC_CHANNELS],
    outputs: Option<Outputs>,
    verdict: Result<(), Fault>,
) -> Autopilot {
    let mut told = Autopilot { rc: rc.map(f64::from), ..Autopilot::zeroed() };
    told.outputs = outputs.map_or([f64::NAN; MAX_OUTPUTS], |o| o.values);
    told.armed = match outputs.and_then(|o| o.armed) {
        Some(true) => armed::YES,
        Some(false) => armed::NO,
        None => armed::UNKNOWN,
    };
    told.fault = match verdict {
        Ok(()) => 0,
        Err(Fault::Silent) => 1,
        Err(Fault::NotFinite) => 2,
        Err(Fault::Disarmed) => 3,
    };
    if let Some(s) = sensors {
        (told.gyro, told.accel, told.mag) = (s.gyro.into(), s.accel.into(), s.mag.into());
        told.pressure = s.pressure;
        told.fix = [s.gps.latitude, s.gps.longitude, s.gps.altitude];
        told.velocity = s.gps.velocity.into();
    }
    told
}
