//! A simulator's part in a MAVLink network: its identity, its heartbeat, and its request for the arming checks.

use crate::mavlink::dialect::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavCmd, MavModeFlag, MavState, MavType,
};
use crate::mavlink::{Header, MavMessage};

/// System id of a simulator.
pub(super) const SYSTEM: u8 = 142;
/// Component id of a simulator.
pub(super) const COMPONENT: u8 = 142;

/// The heartbeat of a simulator.
pub(super) fn heartbeat() -> MavMessage {
    MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_GENERIC,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
    })
}

/// Requests a report of the vehicle's arming checks.
pub(super) fn ask_for_arming_checks(vehicle: Header) -> MavMessage {
    MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        target_system: vehicle.system,
        target_component: vehicle.component,
        command: MavCmd::MAV_CMD_RUN_PREARM_CHECKS,
        ..Default::default()
    })
}

/// True when a message is the heartbeat of a vehicle, and not of a station.
pub(super) fn is_vehicles_beat(message: &MavMessage) -> bool {
    matches!(message, MavMessage::HEARTBEAT(beat) if beat.autopilot != MavAutopilot::MAV_AUTOPILOT_INVALID)
}
