//! Receives an autopilot's attitude estimate over its telemetry, not over the link of the simulated sensors,
//! as a reference for a check of the sensors.

use std::time::Duration;

use crate::mavlink::dialect::{
    COMMAND_LONG_DATA, HEARTBEAT_DATA, MavAutopilot, MavCmd, MavModeFlag, MavState, MavType,
};
use crate::mavlink::{Deframer, Encoder, Event, Header, MavMessage};
use crate::msp::{self, Answer, Parser};
use crate::sensors::wrapped;

/// Time between two heartbeats, and between two unanswered requests for the attitude.
const SECOND: Duration = Duration::from_secs(1);
/// Time between two queries in a protocol without streaming.
const ASK: Duration = Duration::from_millis(50);
/// Message number of ATTITUDE.
const ATTITUDE: f32 = 30.0;
/// Requested interval, us.
const INTERVAL_US: f32 = 20_000.0;

/// The protocol of an autopilot's telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TelemetryProtocol {
    /// MAVLink: PX4 and ArduPilot.
    Mavlink,
    /// MultiWii Serial Protocol: Betaflight.
    Msp,
}

/// State of the conversation in each protocol.
enum Conversation {
    Mavlink(Box<Station>),
    Msp(Parser),
}

/// State of a MAVLink ground station.
struct Station {
    deframer: Deframer,
    encoder: Encoder,
    target: Option<Header>,
    next_beat: Duration,
}

/// Receives the attitude of one autopilot.
pub struct AttitudeReceiver {
    conversation: Conversation,
    attitude: Option<([f64; 3], Duration)>,
    next_ask: Duration,
}

impl AttitudeReceiver {
    /// A receiver without data.
    pub fn new(protocol: TelemetryProtocol) -> Self {
        let conversation = match protocol {
            TelemetryProtocol::Mavlink => Conversation::Mavlink(Box::new(Station {
                deframer: Deframer::new(),
                encoder: Encoder::new(255, 190),
                target: None,
                next_beat: Duration::ZERO,
            })),
            TelemetryProtocol::Msp => Conversation::Msp(Parser::default()),
        };
        Self { conversation, attitude: None, next_ask: Duration::ZERO }
    }

    /// True when a datagram of an unknown sender is, by itself, an autopilot's: it contains its heartbeat, or
    /// an answer.
    pub fn recognises(&mut self, datagram: &[u8], now: Duration) -> bool {
        match &mut self.conversation {
            Conversation::Mavlink(station) => station.deframer.recognises(datagram, now, |_, message| {
                matches!(message, MavMessage::HEARTBEAT(beat)
                    if beat.autopilot != MavAutopilot::MAV_AUTOPILOT_INVALID)
            }),
            Conversation::Msp(_) => {
                let mut parser = Parser::default();
                parser.push(datagram);
                parser.next_answer().is_some()
            }
        }
    }

    /// Resets for another sender, as data of the previous one do not count any more.
    pub fn forget(&mut self) {
        self.attitude = None;
        if let Conversation::Mavlink(station) = &mut self.conversation {
            station.target = None;
        }
    }

    /// Decodes the autopilot's bytes; returns whether any of them were valid.
    pub fn receive(&mut self, bytes: &[u8], now: Duration) -> bool {
        let mut valid = false;
        match &mut self.conversation {
            Conversation::Mavlink(station) => {
                let target = &mut station.target;
                station.deframer.push(bytes);
                while let Some(event) = station.deframer.next(now) {
                    valid |= matches!(event, Event::Message(..));
                    match event {
                        Event::Message(header, MavMessage::HEARTBEAT(beat))
                            if beat.autopilot != MavAutopilot::MAV_AUTOPILOT_INVALID =>
                        {
                            target.get_or_insert(header);
                        }
                        Event::Message(header, MavMessage::ATTITUDE(a))
                            if target.is_some_and(|t| t.system == header.system) =>
                        {
                            self.attitude = Some(([a.roll, a.pitch, a.yaw].map(f64::from), now));
                        }
                        _ => {}
                    }
                }
            }
            Conversation::Msp(parser) => {
                parser.push(bytes);
                while let Some(answer) = parser.next_answer() {
                    if let Answer::Attitude(angles) = answer {
                        self.attitude = Some((angles, now));
                    }
                    valid = true;
                }
            }
        }
        self.attitude = self.attitude.filter(|(angles, _)| angles.iter().all(|a| a.is_finite()));
        valid
    }

    /// Appends messages to the autopilot; to be called every few milliseconds.
    pub fn ask(&mut self, now: Duration, out: &mut Vec<u8>) {
        match &mut self.conversation {
            Conversation::Mavlink(station) => {
                let Station { encoder, target, next_beat, .. } = &mut **station;
                if now >= *next_beat {
                    *next_beat = now + SECOND;
                    encoder.encode(&MavMessage::HEARTBEAT(ground_station()), now, out);
                }
                let Some(target) = target else { return };
                let silent = self.attitude.is_none_or(|(_, at)| now.saturating_sub(at) > SECOND / 10);
                if silent && now >= self.next_ask {
                    self.next_ask = now + SECOND;
                    let ask = COMMAND_LONG_DATA {
                        target_system: target.system,
                        target_component: target.component,
                        command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
                        param1: ATTITUDE,
                        param2: INTERVAL_US,
                        ..Default::default()
                    };
                    encoder.encode(&MavMessage::COMMAND_LONG(ask), now, out);
                }
            }
            Conversation::Msp(_) => {
                if now >= self.next_ask {
                    self.next_ask = now + ASK;
                    out.extend_from_slice(&msp::ATTITUDE_REQUEST);
                }
            }
        }
    }

    /// Roll (right side down), pitch (nose up) and yaw (clockwise from above), rad, unless they are older
    /// than `age`.
    pub fn attitude(&self, age: Duration, now: Duration) -> Option<[f64; 3]> {
        let (angles, at) = self.attitude?;
        (now.saturating_sub(at) <= age).then(|| angles.map(wrapped))
    }
}

fn ground_station() -> HEARTBEAT_DATA {
    HEARTBEAT_DATA {
        mavtype: MavType::MAV_TYPE_GCS,
        autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
        base_mode: MavModeFlag::empty(),
        system_status: MavState::MAV_STATE_ACTIVE,
        mavlink_version: 3,
        ..Default::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::ATTITUDE_DATA;

    const AGE: Duration = Duration::from_millis(500);

    #[test]
    fn mavlink_is_asked_for_the_attitude_and_believed_of_the_autopilot_alone() {
        let mut receiver = AttitudeReceiver::new(TelemetryProtocol::Mavlink);
        let mut said = Vec::new();
        let now = Duration::from_secs(1);
        receiver.ask(now, &mut said);
        let says = |system: u8, message: &MavMessage| {
            let mut bytes = Vec::new();
            Encoder::new(system, 1).encode(message, now, &mut bytes);
            bytes
        };
        let attitude = MavMessage::ATTITUDE(ATTITUDE_DATA { roll: 0.25, yaw: 6.0, ..Default::default() });
        receiver.receive(&says(1, &attitude), now);
        assert_eq!(receiver.attitude(AGE, now), None, "nobody said that it is an autopilot");
        let beat = HEARTBEAT_DATA { autopilot: MavAutopilot::MAV_AUTOPILOT_PX4, ..ground_station() };
        receiver.receive(&says(1, &MavMessage::HEARTBEAT(beat)), now);
        receiver.ask(now, &mut said);
        receiver.receive(&says(7, &attitude), now);
        assert_eq!(receiver.attitude(AGE, now), None, "another system");
        receiver.receive(&says(1, &attitude), now);
        let [roll, pitch, yaw] = receiver.attitude(AGE, now).unwrap();
        assert_eq!((roll, pitch), (0.25, 0.0));
        assert!((yaw - (6.0 - std::f64::consts::TAU)).abs() < 1e-6, "{yaw}");
        assert_eq!(receiver.attitude(AGE, now + SECOND), None, "too old");
        let mut deframer = Deframer::new();
        deframer.push(&said);
        let asked: Vec<_> = std::iter::from_fn(|| deframer.next(now)).collect();
        assert!(
            matches!(&asked[..], [Event::Message(_, MavMessage::HEARTBEAT(_)), Event::Message(_, MavMessage::COMMAND_LONG(c))]
                if c.param1 == 30.0 && c.target_system == 1),
            "{asked:?}"
        );
    }

    #[test]
    fn msp_is_asked_again_and_again_and_its_pitch_is_turned() {
        let mut receiver = AttitudeReceiver::new(TelemetryProtocol::Msp);
        let mut said = Vec::new();
        for ms in [0, 10, 50, 60, 100] {
            receiver.ask(Duration::from_millis(ms), &mut said);
        }
        assert_eq!(said, b"$M<\0\x6c\x6c".repeat(3));
        // Roll 10.0, pitch -20.0 (nose up in Betaflight), heading 350 degrees.
        let payload = [100i16, -200, 350].map(i16::to_le_bytes).concat();
        let mut frame = b"$M>\x06\x6c".to_vec();
        frame.extend(&payload);
        frame.push(payload.iter().fold(0x06 ^ 0x6c, |sum, b| sum ^ b));
        receiver.receive(&frame, SECOND);
        let angles = receiver.attitude(AGE, SECOND).unwrap().map(f64::to_degrees);
        for (angle, wanted) in angles.into_iter().zip([10.0, 20.0, -10.0]) {
            assert!((angle - wanted).abs() < 1e-9, "{angles:?}");
        }
    }
}
