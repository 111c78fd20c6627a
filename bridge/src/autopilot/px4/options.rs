//! Options of the link to PX4, and the capacity of a serial line.

use serde::{Deserialize, Serialize};

use crate::line::{COMMON_SHARE, serial_line};
use crate::peer::Pin;

/// The TCP port of PX4's first instance.
pub const PORT: u16 = 4560;

/// Port on which PX4 as software in the loop speaks to its camera, besides its ground station and its
/// companion; plus the instance.
const CAMERA_PORT: u16 = 14030;

/// Largest number of PX4 instances on one computer.
const INSTANCES: u16 = 256;

/// Time between two messages of the pilot's channels, ns.
pub(super) const CHANNEL_PERIOD_NS: u64 = 20_000_000;

/// Time between two messages of the true state, until PX4 requests another one, ns.
pub(super) const STATE_PERIOD_NS: u64 = 5_000_000;

/// Bytes of the longest frames: HIL_SENSOR, HIL_GPS, RC_CHANNELS, HIL_STATE_QUATERNION and HEARTBEAT.
const SENSOR_BYTES: f64 = 77.0;
const GPS_BYTES: f64 = 51.0;
const CHANNEL_BYTES: f64 = 54.0;
const STATE_BYTES: f64 = 76.0;
const HEARTBEAT_BYTES: f64 = 21.0;

/// Options of the link to PX4.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Px4Options {
    /// Address of PX4: `tcpin://ADDRESS:PORT` where PX4 connects, or `serial://DEVICE:BAUD` or
    /// `udpin://ADDRESS:PORT` for hardware.
    pub link: String,
    /// The only accepted sender on `udpin` and `tcpin`; absent: the first one with a valid message.
    pub peer: Option<Pin>,
    /// Address at which a ground station reaches PX4 through this bridge, for example
    /// `udpout://127.0.0.1:14550`.
    pub forward: Option<String>,
    /// Address of PX4's telemetry with the reasons why it does not arm, when it does not report them on
    /// `link`; empty: none; absent: [`Px4Options::telemetry_place`].
    pub telemetry: Option<String>,
    /// True to send the pitot's differential pressure.
    pub airspeed: bool,
    /// True to send the pilot's channels; otherwise PX4 is controlled by its ground station alone.
    pub rc: bool,
}

impl Default for Px4Options {
    fn default() -> Self {
        let link = format!("tcpin://127.0.0.1:{PORT}");
        Self { link, peer: None, forward: None, telemetry: None, airspeed: false, rc: false }
    }
}

impl Px4Options {
    /// Default address of PX4's telemetry with the reasons why it does not arm. As software in the loop it
    /// does not report them on its simulator's link, but on each of its MAVLink ports: the one for a camera,
    /// which is otherwise unused, on this computer.
    ///
    /// Source: `ROMFS/px4fmu_common/init.d-posix/px4-rc.mavlink` of PX4.
    pub fn telemetry_place(&self) -> Option<String> {
        match &self.telemetry {
            Some(place) => (!place.is_empty()).then(|| place.clone()),
            None => {
                let port: u16 = self.link.strip_prefix("tcpin://")?.rsplit_once(':')?.1.parse().ok()?;
                let instance = port.checked_sub(PORT).filter(|instance| *instance < INSTANCES)?;
                Some(format!("udpin://127.0.0.1:{}", CAMERA_PORT + instance))
            }
        }
    }

    /// Shortest time between two messages of the true state that leaves enough of the line to the sensors,
    /// ns.
    ///
    /// # Errors
    /// A sentence, when the line is too slow for `rate_hz` sensors and `gps_hz` fixes per second.
    pub(in crate::autopilot) fn state_period_ns(&self, rate_hz: f64, gps_hz: f64) -> Result<u64, String> {
        let Some((baud, bits)) = serial_line(&self.link) else { return Ok(STATE_PERIOD_NS) };
        let carried = COMMON_SHARE * baud / bits;
        let channels = if self.rc { CHANNEL_BYTES * 1e9 / CHANNEL_PERIOD_NS as f64 } else { 0.0 };
        let left = carried - HEARTBEAT_BYTES - GPS_BYTES * gps_hz - channels;
        let most_hz = (left / SENSOR_BYTES).floor();
        if rate_hz > most_hz {
            return Err(format!(
                "{} carries {carried:.0} bytes a second for the sensors, and {rate_hz:.0} HIL_SENSOR a second are more: give the \
                 line a higher rate, or rate_hz at most {most_hz:.0}",
                self.link
            ));
        }
        let state_hz = (left - SENSOR_BYTES * rate_hz) / STATE_BYTES;
        // Less than one per second means none.
        Ok(if state_hz < 1.0 { u64::MAX } else { STATE_PERIOD_NS.max((1e9 / state_hz) as u64) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_instance_in_software_has_a_place_where_it_is_listened_to_and_a_board_has_none() {
        let place = |link: &str, telemetry: Option<&str>| {
            let telemetry = telemetry.map(String::from);
            Px4Options { link: link.into(), telemetry, ..Px4Options::default() }.telemetry_place()
        };
        assert_eq!(place("tcpin://127.0.0.1:4560", None).unwrap(), "udpin://127.0.0.1:14030");
        assert_eq!(place("tcpin://0.0.0.0:4563", None).unwrap(), "udpin://127.0.0.1:14033");
        assert_eq!(place("tcpin://127.0.0.1:40000", None), None, "no port of an instance");
        assert_eq!(place("serial:///dev/ttyACM0:921600", None), None, "it says it there");
        assert_eq!(place("tcpin://127.0.0.1:4560", Some("")), None);
        let own = "udpin://127.0.0.1:14540";
        assert_eq!(place("serial:///dev/ttyACM0:921600", Some(own)).unwrap(), own);
    }
}
