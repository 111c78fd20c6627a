//! The ground station that shares PX4's line with the loop: a router by system and component.
//!
//! PX4's messages are forwarded to the station, except those to the simulator. The station's messages are
//! forwarded to PX4, except those that the loop controls: the sensors, the rate of the outputs, the pilot's
//! channels where the bench has them, the ids of simulator and vehicle, and whether the line is signed.

use std::time::Duration;

use mavlink::Message;

use super::super::simulator::{COMPONENT, SYSTEM};
use crate::forward::Forward;
use crate::mavlink::dialect::MavCmd;
use crate::mavlink::{Deframer, Event, Header, MavMessage};
use crate::note::Notes;

/// Message number of HIL_ACTUATOR_CONTROLS.
const ACTUATOR_CONTROLS: f32 = 93.0;

/// Optional properties that the loop controls.
#[derive(Debug, Clone, Copy)]
pub(super) struct Owned {
    /// System and component of the vehicle, once known.
    pub vehicle: Option<(u8, u8)>,
    /// True when the bench has the pilot's channels.
    pub channels: bool,
}

/// State of the conversation with the station.
#[derive(Debug)]
pub(super) struct Station {
    deframer: Deframer,
    refused: u64,
    /// Permitted frames that wait for room on PX4's link.
    pub(super) waiting: Forward,
}

impl Station {
    pub(super) fn new(waiting: Forward) -> Self {
        Self { deframer: Deframer::new(), refused: 0, waiting }
    }

    /// Number of messages that were not forwarded.
    pub(super) fn refused(&self) -> u64 {
        self.refused
    }

    /// True when a datagram of an unknown sender contains a MAVLink message.
    pub(super) fn recognises(&mut self, datagram: &[u8], now: Duration) -> bool {
        self.deframer.recognises(datagram, now, |_, _| true)
    }

    /// Discards a partly received message.
    pub(super) fn end(&mut self) {
        let _ = self.deframer.end();
    }

    /// Decodes the station's bytes; permitted messages wait until PX4's link has room. Returns whether
    /// something was valid.
    pub(super) fn receive(&mut self, bytes: &[u8], now: Duration, owned: Owned, notes: &mut Notes) -> bool {
        self.deframer.push(bytes);
        let mut valid = false;
        while let Some(event) = self.deframer.next(now) {
            let Event::Message(header, message) = event else { continue };
            valid = true;
            match owner(&header, &message, owned) {
                None => self.waiting.push(self.deframer.frame(), now, notes),
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

/// True when a message of PX4 is forwarded to the station.
pub(super) fn is_for_station(message: &MavMessage) -> bool {
    !matches!(message, MavMessage::HIL_ACTUATOR_CONTROLS(_)) && message.target_system_id() != Some(SYSTEM)
}

/// The loop's property that a station's message would change; `None` for a permitted message.
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
