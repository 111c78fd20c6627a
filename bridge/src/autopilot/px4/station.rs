//! The ground station that shares PX4's line with the loop: a router by system and component.
//!
//! What PX4 says goes to the station as well, but for what it says to the simulator. What the station says goes to PX4, but for
//! what the loop owns: the sensors, the rate of the outputs, the pilot's channels where the bench has them, the names of
//! simulator and vehicle, and whether the line is signed.

use std::time::Duration;

use mavlink::Message;

use super::messages::{COMPONENT, SYSTEM};
use crate::mavlink::dialect::MavCmd;
use crate::mavlink::{Deframer, Event, Header, MavMessage};
use crate::note::Notes;

/// Message number of HIL_ACTUATOR_CONTROLS.
const ACTUATOR_CONTROLS: f32 = 93.0;

/// What the loop owns beside what it always does.
#[derive(Debug, Clone, Copy)]
pub(super) struct Owned {
    /// System and component of the vehicle, once it was heard.
    pub vehicle: Option<(u8, u8)>,
    /// The bench has the pilot's channels.
    pub channels: bool,
}

/// The conversation with the station.
#[derive(Debug, Default)]
pub(super) struct Station {
    deframer: Deframer,
    refused: u64,
}

impl Station {
    /// Messages that were not passed on.
    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    /// Whether a datagram of somebody unknown holds a MAVLink message.
    pub(super) fn recognises(&mut self, datagram: &[u8], now: Duration) -> bool {
        self.deframer.recognises(datagram, now, |_, _| true)
    }

    /// Gives up what was half received.
    pub(super) fn end(&mut self) {
        let _ = self.deframer.end();
    }

    /// Takes in what the station says, and passes on what it may say to PX4. Returns whether something was valid.
    pub(super) fn receive(
        &mut self,
        bytes: &[u8],
        now: Duration,
        owned: Owned,
        notes: &mut Notes,
        pass: &mut dyn FnMut(&[u8]),
    ) -> bool {
        self.deframer.push(bytes);
        let mut valid = false;
        while let Some(event) = self.deframer.next(now) {
            let Event::Message(header, message) = event else { continue };
            valid = true;
            match owner(&header, &message, owned) {
                None => pass(self.deframer.frame()),
                Some(what) => {
                    self.refused += 1;
                    if self.refused == 1 {
                        let name = message.message_name();
                        notes
                            .warn(format!("the ground station sent {name}: {what}, and it is not passed on"));
                    }
                }
            }
        }
        valid
    }
}

/// Whether what PX4 says is for the station as well.
pub(super) fn is_for_station(message: &MavMessage) -> bool {
    !matches!(message, MavMessage::HIL_ACTUATOR_CONTROLS(_)) && message.target_system_id() != Some(SYSTEM)
}

/// What of a station's message belongs to the loop; `None` for one that the station may send.
#[expect(deprecated, reason = "a station may send HIL_STATE all the same")]
fn owner(header: &Header, message: &MavMessage, owned: Owned) -> Option<&'static str> {
    let from = (header.system, header.component);
    if from == (SYSTEM, COMPONENT) {
        return Some("it speaks as the simulator, which is this bench");
    }
    if Some(from) == owned.vehicle {
        return Some("it speaks as the vehicle");
    }
    match message {
        MavMessage::HIL_SENSOR(_)
        | MavMessage::HIL_GPS(_)
        | MavMessage::HIL_STATE(_)
        | MavMessage::HIL_STATE_QUATERNION(_)
        | MavMessage::HIL_OPTICAL_FLOW(_)
        | MavMessage::HIL_RC_INPUTS_RAW(_)
        | MavMessage::HIL_CONTROLS(_)
        | MavMessage::HIL_ACTUATOR_CONTROLS(_)
        | MavMessage::GPS_INPUT(_) => Some("the sensors are the bench's"),
        MavMessage::RC_CHANNELS(_) | MavMessage::RC_CHANNELS_OVERRIDE(_) | MavMessage::MANUAL_CONTROL(_)
            if owned.channels =>
        {
            Some("the pilot's channels are the bench's (bridge.px4.rc)")
        }
        MavMessage::SETUP_SIGNING(_) => Some("the bench shares the line, and does not sign"),
        MavMessage::COMMAND_LONG(m) if is_rate_of_outputs(m.command, m.param1) => Some(RATE),
        MavMessage::COMMAND_INT(m) if is_rate_of_outputs(m.command, m.param1) => Some(RATE),
        _ => None,
    }
}

const RATE: &str = "the loop flies on the rate of the outputs";

fn is_rate_of_outputs(command: MavCmd, number: f32) -> bool {
    command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL && number == ACTUATOR_CONTROLS
}
