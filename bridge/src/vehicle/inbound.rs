//! Processes bytes from the ports.

use std::time::Duration;

use super::receivers::Receivers;
use super::{Group, Port, SBUS_PAUSE, Source, Vehicle};
use crate::config::PilotSource;
use crate::crsf;
use crate::sbus;

/// Number of bytes without a CRSF frame from which a wrong baud rate is reported.
const BAUD_WARNING_BYTES: u64 = 300;

/// Result of bytes from a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Received {
    /// True when some of them were valid, and from the correct sender.
    pub valid: bool,
    /// True when an attitude arrived that no measurement contains yet.
    pub attitude: bool,
}

impl Vehicle {
    /// True when a datagram of a sender that is not a port's peer makes it the peer: by itself it is a valid
    /// message, signed where required, and on the vehicle's link the heartbeat of the awaited autopilot.
    pub fn recognises(&mut self, port: Port, datagram: &[u8], now: Duration) -> bool {
        match (port, &mut self.source) {
            (Port::Link, Source::Mavlink(autopilot)) => autopilot.recognises(datagram, now, &mut self.notes),
            (Port::Link, Source::Crsf { .. }) => is_crsf(datagram),
            (Port::Pilot, _) if self.pilot_source == Some(PilotSource::Sbus) => {
                let mut parser = sbus::Parser::new();
                parser.push(datagram);
                parser.next_frame().is_some()
            }
            (Port::Pilot, _) => is_crsf(datagram),
            (Port::Ground, _) => self.ground.deframer.recognises(datagram, now, |_, _| true),
            (Port::Output, _) => false,
        }
    }

    /// Resets a port whose peer was replaced.
    pub fn peer_changed(&mut self, port: Port) {
        self.connected(port);
        if let (Port::Link, Source::Mavlink(autopilot)) = (port, &mut self.source) {
            autopilot.forget();
        }
        if port == Port::Link {
            self.telemetry.restart();
            let _ = self.telemetry.take_restart();
            if !self.has_failed()
                && let Some(mode) = self.arming.restarted()
            {
                self.announce(mode);
            }
        }
    }

    /// Decodes bytes from a port; `end` means that no frame continues after them, as in a datagram.
    pub fn receive(&mut self, port: Port, bytes: &[u8], end: bool, now: Duration) -> Received {
        let before = self.spoken(port);
        match port {
            Port::Link => self.receive_link(bytes, end, now),
            Port::Pilot => self.receive_pilot(bytes, now),
            Port::Ground => self.receive_ground(bytes, now),
            Port::Output => {}
        }
        let received = Received {
            valid: self.spoken(port) > before,
            attitude: self.telemetry.is_fresh(Group::Attitude),
        };
        if self.telemetry.take_restart() {
            self.notes.warn("the vehicle's clock went back: it restarted");
            if let Source::Mavlink(autopilot) = &mut self.source {
                autopilot.begin_anew();
            }
            if let Some(mode) = self.arming.restarted() {
                self.announce(mode);
            }
        }
        received
    }

    /// Number of valid messages of a port from the correct sender.
    fn spoken(&self, port: Port) -> u64 {
        match (port, &self.source) {
            (Port::Link, Source::Mavlink(autopilot)) => autopilot.spoken(),
            (Port::Link, Source::Crsf { parser, .. }) => parser.counts().frames,
            (Port::Pilot, _) => self.pilot_crsf.counts().frames + self.pilot_sbus.counts().frames,
            (Port::Ground, _) => self.ground.deframer.counts().messages,
            (Port::Output, _) => 0,
        }
    }

    /// Updates the sticks of a gamepad, us.
    pub fn stick(&mut self, us: &[f64], now: Duration) {
        if let Some(pilot) = &mut self.pilot {
            pilot.update(us, false, now);
        }
    }

    /// Discards partly received data after a port was reconnected.
    pub fn connected(&mut self, port: Port) {
        self.set_closed(port, false);
        self.forget_forwarded(port);
        match (port, &mut self.source) {
            (Port::Link, Source::Mavlink(autopilot)) => autopilot.begin_anew(),
            (Port::Link, Source::Crsf { parser, .. }) => parser.reset(),
            (Port::Pilot, _) => {
                self.pilot_crsf.reset();
                self.pilot_sbus.reset();
            }
            (Port::Output | Port::Ground, _) => {}
        }
    }

    pub(super) fn receive_link(&mut self, bytes: &[u8], end: bool, now: Duration) {
        match &mut self.source {
            Source::Mavlink(autopilot) => {
                if self.mavlink.as_ref().is_some_and(|m| m.forward.is_some()) {
                    self.out[Port::Ground as usize].extend_from_slice(bytes);
                }
                let pilot = match self.pilot_source {
                    Some(PilotSource::Mavlink) => self.pilot.as_mut(),
                    _ => None,
                };
                let reply = &mut self.out[Port::Link as usize];
                let mut receivers =
                    Receivers { telemetry: &mut self.telemetry, pilot, notes: &mut self.notes, reply };
                autopilot.receive(bytes, end, now, &mut receivers);
            }
            Source::Crsf { parser, quality, linked_at, warned, .. } => {
                parser.push(bytes);
                while let Some(event) = parser.next_event() {
                    match event {
                        crsf::Event::Attitude(a) => {
                            let angles = [a.roll, a.pitch, a.yaw];
                            let _ = self.telemetry.take(Group::Attitude, angles, None, now);
                            *linked_at = Some(now);
                        }
                        crsf::Event::LinkStatistics(link) => {
                            *quality = Some(link.uplink_quality);
                            *linked_at = Some(now);
                        }
                        crsf::Event::Battery(b) if b.remaining_percent == 0 => {
                            self.notes.warn(format!("the battery is empty: {:.1} V", b.voltage_v));
                        }
                        _ => {}
                    }
                }
                let counts = parser.counts();
                if !*warned && counts.frames == 0 && counts.bytes > BAUD_WARNING_BYTES {
                    *warned = true;
                    self.notes.warn(format!(
                        "{} bytes arrived, none of them CRSF: check the baud rate (416666 or 420000)",
                        counts.bytes
                    ));
                }
            }
        }
    }

    pub(super) fn receive_pilot(&mut self, bytes: &[u8], now: Duration) {
        let Some(pilot) = &mut self.pilot else { return };
        if now.saturating_sub(self.pilot_bytes_at) > SBUS_PAUSE {
            self.pilot_sbus.reset();
        }
        self.pilot_bytes_at = now;
        match self.pilot_source {
            Some(PilotSource::Sbus) => {
                self.pilot_sbus.push(bytes);
                while let Some(frame) = self.pilot_sbus.next_frame() {
                    pilot.update(&frame.channels.map(sbus::us_of_ticks), frame.failsafe, now);
                }
            }
            Some(PilotSource::Crsf) => {
                self.pilot_crsf.push(bytes);
                while let Some(event) = self.pilot_crsf.next_event() {
                    if let crsf::Event::Channels(c) = event {
                        pilot.update(&c.0.map(crsf::us_of_ticks), false, now);
                    }
                }
            }
            _ => {}
        }
    }
}

/// True when a datagram contains a complete CRSF frame.
fn is_crsf(datagram: &[u8]) -> bool {
    let mut parser = crsf::Parser::new();
    parser.push(datagram);
    while parser.next_event().is_some() {}
    parser.counts().frames > 0
}
