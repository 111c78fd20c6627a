//! Names of flight modes.
//!
//! Source: `Mode::Number` of ArduCopter (`ArduCopter/mode.h`).

use super::dialect::{HEARTBEAT_DATA, MavAutopilot, MavType};

/// Modes of ArduPilot's copters, by their number; some numbers are not in use.
const COPTER: [&str; 29] = [
    "Stabilize",
    "Acro",
    "AltHold",
    "Auto",
    "Guided",
    "Loiter",
    "RTL",
    "Circle",
    "",
    "Land",
    "",
    "Drift",
    "",
    "Sport",
    "Flip",
    "AutoTune",
    "PosHold",
    "Brake",
    "Throw",
    "Avoid_ADSB",
    "Guided_NoGPS",
    "SmartRTL",
    "FlowHold",
    "Follow",
    "ZigZag",
    "SystemID",
    "Heli_Autorotate",
    "Auto RTL",
    "Turtle",
];

/// The flight mode in a heartbeat, if it is one of a copter of ArduPilot: of others the number means something else.
pub(crate) fn flight_mode(beat: &HEARTBEAT_DATA) -> Option<&'static str> {
    use MavType as Type;
    let is_copter = matches!(
        beat.mavtype,
        Type::MAV_TYPE_QUADROTOR
            | Type::MAV_TYPE_COAXIAL
            | Type::MAV_TYPE_HELICOPTER
            | Type::MAV_TYPE_HEXAROTOR
            | Type::MAV_TYPE_OCTOROTOR
            | Type::MAV_TYPE_TRICOPTER
            | Type::MAV_TYPE_DODECAROTOR
            | Type::MAV_TYPE_DECAROTOR
    );
    if !is_copter || beat.autopilot != MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA {
        return None;
    }
    COPTER.get(beat.custom_mode as usize).copied().filter(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_a_mode_of_a_copter_of_ardupilot_alone() {
        let mode = |mavtype, autopilot, custom_mode| {
            flight_mode(&HEARTBEAT_DATA { mavtype, autopilot, custom_mode, ..Default::default() })
        };
        let (quad, plane) = (MavType::MAV_TYPE_QUADROTOR, MavType::MAV_TYPE_FIXED_WING);
        let ardupilot = MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA;
        assert_eq!(mode(quad, ardupilot, 0), Some("Stabilize"));
        assert_eq!(mode(quad, ardupilot, 20), Some("Guided_NoGPS"));
        assert_eq!(mode(quad, ardupilot, 28), Some("Turtle"));
        for none in [8, 29, 0x0304_0000] {
            assert_eq!(mode(quad, ardupilot, none), None, "{none}");
        }
        assert_eq!(mode(plane, ardupilot, 0), None, "a plane's mode 0 is manual");
        assert_eq!(mode(quad, MavAutopilot::MAV_AUTOPILOT_PX4, 4), None);
    }
}
