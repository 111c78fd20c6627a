//! What ArduPilot says to its ground stations, of which this is one more: its state, and why it does not arm. Its
//! simulation interface has none of it, and nothing here controls anything.
//!
//! ArduPilot sends its texts only on links on which it has received something, reports failing checks every 30 s,
//! and at once when it is asked (`MAV_CMD_RUN_PREARM_CHECKS`).
//!
//! Source: `GCS::send_textv` and `GCS_MAVLINK::handle_command_run_prearm_checks`
//! (`libraries/GCS_MAVLink/GCS_Common.cpp`), `AP_Arming::update` (`libraries/AP_Arming/AP_Arming.cpp`).

use std::time::Duration;

use super::super::heard::Heard;
use super::super::simulator::{self, COMPONENT, SYSTEM, is_vehicles_beat};
use crate::mavlink::{Deframer, Encoder, Event};
use crate::note::Notes;

/// Port of its MAVLink link; its simulation interface is port 0.
pub const TELEMETRY: usize = 1;

/// Time between two heartbeats of this station.
const HEARTBEAT_PERIOD: Duration = Duration::from_secs(1);

/// Time between two requests for the failing checks.
const CHECKS_PERIOD: Duration = Duration::from_secs(4);

/// State of the conversation.
#[derive(Debug)]
pub(super) struct Telemetry {
    deframer: Deframer,
    encoder: Encoder,
    pub heard: Heard,
    next_beat: Duration,
    next_checks: Duration,
}

impl Telemetry {
    pub(super) fn new() -> Self {
        Self {
            deframer: Deframer::new(),
            encoder: Encoder::new(SYSTEM, COMPONENT),
            heard: Heard::new("ArduPilot"),
            next_beat: Duration::ZERO,
            next_checks: Duration::ZERO,
        }
    }

    /// True when a datagram of an unknown sender contains the heartbeat of a vehicle.
    pub(super) fn recognises(&mut self, datagram: &[u8], now: Duration) -> bool {
        self.deframer.recognises(datagram, now, |_, message| is_vehicles_beat(message))
    }

    /// Processes bytes of ArduPilot; returns whether any were valid.
    pub(super) fn receive(&mut self, bytes: &[u8], now: Duration, notes: &mut Notes) -> bool {
        self.deframer.push(bytes);
        let mut valid = false;
        while let Some(event) = self.deframer.next(now) {
            if let Event::Message(header, message) = event {
                valid = true;
                self.heard.hear(TELEMETRY, header, &message, notes);
            }
        }
        valid
    }

    /// No later bytes continue the last ones: a datagram is complete, or the link was lost.
    pub(super) fn end(&mut self) {
        // An incomplete message beside the loop means nothing to it.
        let _ = self.deframer.end();
    }

    /// Appends what is due to be said.
    pub(super) fn say(&mut self, now: Duration, out: &mut Vec<u8>) {
        if now >= self.next_beat {
            self.next_beat = now + HEARTBEAT_PERIOD;
            self.encoder.encode(&simulator::heartbeat(), now, out);
        }
        let vehicle = self.heard.vehicle().filter(|_| !self.heard.is_armed() && now >= self.next_checks);
        if let Some(vehicle) = vehicle {
            self.next_checks = now + CHECKS_PERIOD;
            self.heard.asked();
            self.encoder.encode(&simulator::ask_for_arming_checks(vehicle), now, out);
        }
    }
}
