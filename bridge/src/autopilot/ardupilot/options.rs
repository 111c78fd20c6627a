//! Options of the link to ArduPilot, with the range of its pulses.

use serde::{Deserialize, Serialize};

use crate::peer::Pin;

/// The UDP port that ArduPilot's first instance sends to.
pub const PORT: u16 = 9002;

/// TCP port of SERIAL1 of the first instance of ArduPilot as software in the loop; SERIAL0 is used by its
/// MAVProxy.
const SERIAL1: u16 = 5762;

/// Distance of the ports of two instances, and the largest number of instances on one computer.
const INSTANCE: u16 = 10;
const INSTANCES: u16 = 256;

/// Options of the link to ArduPilot, with the range of its pulses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArdupilotOptions {
    /// Address on which ArduPilot's packets arrive, `udpin://ADDRESS:PORT`; they are answered to their
    /// sender.
    pub link: String,
    /// The only accepted sender; absent: the first one with a valid packet.
    pub peer: Option<Pin>,
    /// Address of a MAVLink link of ArduPilot, on which it says why it does not arm; empty: none; absent:
    /// [`ArdupilotOptions::telemetry_place`].
    pub telemetry: Option<String>,
    /// Pulse of a motor at rest, or of a servo at -1, us.
    pub pwm_min: u16,
    /// Pulse of a motor at full thrust, or of a servo at 1, us.
    pub pwm_max: u16,
}

impl Default for ArdupilotOptions {
    fn default() -> Self {
        let link = format!("udpin://127.0.0.1:{PORT}");
        Self { link, peer: None, telemetry: None, pwm_min: 1000, pwm_max: 2000 }
    }
}

impl ArdupilotOptions {
    /// The address of its MAVLink link. By default SERIAL1 of the instance that sends to this port, on this
    /// computer.
    ///
    /// Source: `libraries/AP_HAL_SITL/SITL_cmdline.cpp` and `SITL_State.h` of ArduPilot.
    pub fn telemetry_place(&self) -> Option<String> {
        match &self.telemetry {
            Some(place) => (!place.is_empty()).then(|| place.clone()),
            None => {
                let port: u16 = self.link.strip_prefix("udpin://")?.rsplit_once(':')?.1.parse().ok()?;
                let above = port.checked_sub(PORT)?;
                let is_instance = above.is_multiple_of(INSTANCE) && above / INSTANCE < INSTANCES;
                is_instance.then(|| format!("tcpout://127.0.0.1:{}", SERIAL1 + above))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_instance_has_a_link_where_it_is_asked() {
        let place = |link: &str, telemetry: Option<&str>| {
            let telemetry = telemetry.map(String::from);
            ArdupilotOptions { link: link.into(), telemetry, ..ArdupilotOptions::default() }.telemetry_place()
        };
        assert_eq!(place("udpin://127.0.0.1:9002", None).unwrap(), "tcpout://127.0.0.1:5762");
        assert_eq!(place("udpin://0.0.0.0:9032", None).unwrap(), "tcpout://127.0.0.1:5792");
        assert_eq!(place("udpin://127.0.0.1:9007", None), None, "no port of an instance");
        assert_eq!(place("udpin://127.0.0.1:9002", Some("")), None);
        let own = "serial:///dev/ttyACM0:115200";
        assert_eq!(place("udpin://127.0.0.1:9002", Some(own)).unwrap(), own);
    }
}
