//! Handles bytes from the ports.

use std::time::Duration;

use super::autopilot::Receivers;
use super::{Group, Port, SBUS_PAUSE, Source, Vehicle};
use crate::config::PilotSource;
use crate::crsf;
use crate::mavlink::{Event, MavMessage};
use crate::sbus;

/// After so many bytes without a frame of CRSF the baud rate is said to be wrong.
const BAUD_WARNING_BYTES: u64 = 300;

impl Vehicle {
    /// A ground station may ask and set, but not steer: what moves the vehicle passes the gate of the bridge alone.
    pub(super) fn receive_ground(&mut self, bytes: &[u8], now: Duration) {
        self.ground.push(bytes);
        while let Some(event) = self.ground.next(now) {
            match event {
                Event::Message(_, message) if steers(&message) => {
                    self.refused_controls += 1;
                    if self.refused_controls == 1 {
                        self.notes.warn("the ground station tried to steer: only this bridge does");
                    }
                }
                Event::Message(..) => {
                    self.out[Port::Link as usize].extend_from_slice(self.ground.frame());
                }
                Event::Dropped(_) => {}
            }
        }
        let _ = self.ground.end();
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
                        "{} bytes came in, and none of them is CRSF: is the baud rate right (416666 or 420000)?",
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

/// Whether a message moves the vehicle.
fn steers(message: &MavMessage) -> bool {
    matches!(
        message,
        MavMessage::RC_CHANNELS_OVERRIDE(_)
            | MavMessage::MANUAL_CONTROL(_)
            | MavMessage::SET_ATTITUDE_TARGET(_)
            | MavMessage::SET_POSITION_TARGET_LOCAL_NED(_)
            | MavMessage::SET_POSITION_TARGET_GLOBAL_INT(_)
            | MavMessage::SET_ACTUATOR_CONTROL_TARGET(_)
    )
}
