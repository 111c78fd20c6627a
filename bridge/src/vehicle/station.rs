//! The ground station behind the bridge: it may query and set, but not steer, as only the bridge's gate may
//! move the vehicle.

use std::time::Duration;

use super::{Port, Source, Vehicle};
use crate::mavlink::dialect::MavCmd;
use crate::mavlink::{Event, MavMessage};

impl Vehicle {
    /// Decodes the station's bytes; permitted frames wait for [`Vehicle::next_forwarded`].
    pub(super) fn receive_ground(&mut self, bytes: &[u8], now: Duration) {
        self.ground.deframer.push(bytes);
        while let Some(event) = self.ground.deframer.next(now) {
            match event {
                Event::Message(_, message) if steers(&message) => {
                    self.ground.refused_controls += 1;
                    if self.ground.refused_controls == 1 {
                        self.notes.warn("the ground station tried to steer: only this bridge may");
                    }
                }
                Event::Message(_, message) if self.changes_rates(&message) => {
                    self.ground.refused_rates += 1;
                    if self.ground.refused_rates == 1 {
                        self.notes.warn(
                            "the ground station asked for other rates of messages that the loop needs: they are unchanged",
                        );
                    }
                }
                Event::Message(..) => {
                    let frame = self.ground.deframer.frame();
                    self.ground.waiting.push(frame, now, &mut self.notes);
                }
                Event::Dropped(_) => {}
            }
        }
        let _ = self.ground.deframer.end();
    }

    /// The next frame of the ground station for which the vehicle's link has room after the outputs. To be
    /// called after the bytes of [`Port::Link`] were sent, until there is none; it is sent by itself.
    pub fn next_forwarded(&mut self, now: Duration) -> Option<Vec<u8>> {
        self.ground.waiting.next(now)
    }

    /// The vehicle's link was lost, and frames to it are obsolete.
    pub(super) fn forget_forwarded(&mut self, port: Port) {
        if port == Port::Link {
            self.ground.waiting.clear();
        }
    }

    /// True when a message changes the rate of another one that the loop needs.
    #[expect(deprecated, reason = "ground stations send REQUEST_DATA_STREAM all the same")]
    fn changes_rates(&self, message: &MavMessage) -> bool {
        let Source::Mavlink(autopilot) = &self.source else { return false };
        match message {
            MavMessage::REQUEST_DATA_STREAM(m) => OUR_STREAMS.contains(&(m.req_stream_id as u32)),
            MavMessage::COMMAND_LONG(m) if m.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                autopilot.needs(m.param1)
            }
            MavMessage::COMMAND_INT(m) if m.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                autopilot.needs(m.param1)
            }
            _ => false,
        }
    }
}

/// True when a message moves the vehicle.
fn steers(message: &MavMessage) -> bool {
    matches!(
        message,
        MavMessage::RC_CHANNELS_OVERRIDE(_)
            | MavMessage::MANUAL_CONTROL(_)
            | MavMessage::SET_ATTITUDE_TARGET(_)
            | MavMessage::SET_POSITION_TARGET_LOCAL_NED(_)
            | MavMessage::SET_POSITION_TARGET_GLOBAL_INT(_)
            | MavMessage::SET_ACTUATOR_CONTROL_TARGET(_)
    ) || command(message).is_some_and(|command| MOVING.contains(&command))
}

/// Commands that move motors or servos directly.
const MOVING: [MavCmd; 6] = [
    MavCmd::MAV_CMD_DO_MOTOR_TEST,
    MavCmd::MAV_CMD_DO_SET_SERVO,
    MavCmd::MAV_CMD_DO_REPEAT_SERVO,
    MavCmd::MAV_CMD_DO_SET_ACTUATOR,
    MavCmd::MAV_CMD_ACTUATOR_TEST,
    MavCmd::MAV_CMD_DO_SET_RELAY,
];

/// Groups of `REQUEST_DATA_STREAM` with messages of the loop: all, raw sensors, radio channels, position,
/// attitude.
const OUR_STREAMS: [u32; 5] = [0, 1, 3, 6, 10];

fn command(message: &MavMessage) -> Option<MavCmd> {
    match message {
        MavMessage::COMMAND_LONG(m) => Some(m.command),
        MavMessage::COMMAND_INT(m) => Some(m.command),
        _ => None,
    }
}
