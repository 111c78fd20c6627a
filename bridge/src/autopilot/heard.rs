//! Messages of an autopilot to all: its heartbeats, and the reasons why it does not arm.

use crate::mavlink::dialect::{HEARTBEAT_DATA, MavAutopilot, MavModeFlag};
use crate::mavlink::{Header, MavMessage, Readiness, flight_mode};
use crate::note::Notes;

/// State from an autopilot's heartbeats and reports.
#[derive(Debug, Clone)]
pub(super) struct Heard {
    name: &'static str,
    /// Identity of the vehicle from its heartbeats, and the port on which they last arrived.
    vehicle: Option<(Header, usize)>,
    /// Its flight mode, where the mode has a name.
    mode: Option<&'static str>,
    readiness: Readiness,
}

impl Heard {
    /// State without any message; `name` is the autopilot's name in notes.
    pub(super) fn new(name: &'static str) -> Self {
        Self { name, vehicle: None, mode: None, readiness: Readiness::new(name) }
    }

    /// Identity of the vehicle.
    pub(super) fn vehicle(&self) -> Option<Header> {
        self.vehicle.map(|(header, _)| header)
    }

    /// Port for queries: one on which it speaks to others than its simulator, if any.
    pub(super) fn answers_at(&self) -> Option<usize> {
        self.vehicle.map(|(_, port)| port)
    }

    /// True when its heartbeats report that it is armed.
    pub(super) fn is_armed(&self) -> bool {
        self.readiness.is_armed()
    }

    /// Reported reason why it is not armed.
    pub(super) fn said(&self) -> Option<&str> {
        self.readiness.said()
    }

    /// Its arming checks are requested anew: what they do not report again holds no longer.
    pub(super) fn asked(&mut self) {
        self.readiness.asked();
    }

    /// Processes a message received through `port`.
    pub(super) fn hear(&mut self, port: usize, header: Header, message: &MavMessage, notes: &mut Notes) {
        match message {
            MavMessage::HEARTBEAT(beat) => self.beat(port, header, beat, notes),
            message => self.readiness.hear(message, notes),
        }
    }

    fn beat(&mut self, port: usize, header: Header, beat: &HEARTBEAT_DATA, notes: &mut Notes) {
        if beat.autopilot == MavAutopilot::MAV_AUTOPILOT_INVALID {
            return;
        }
        let armed = beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        let answers_at = self.answers_at().map_or(port, |known| known.max(port));
        let (name, mode) = (self.name, flight_mode(beat));
        let state = if armed { "armed" } else { "not armed" };
        match self.vehicle {
            None => {
                let Header { system, component, .. } = header;
                let mode = mode.map_or(String::new(), |mode| format!(", in mode {mode}"));
                notes.warn(format!(
                    "{name} is system {system}, component {component}, and says that it is {state}{mode}"
                ));
            }
            // Other components have their own heartbeats.
            Some((known, _)) if (known.system, known.component) != (header.system, header.component) => {
                return;
            }
            Some(_) => {
                if let Some(mode) = mode.filter(|_| mode != self.mode) {
                    notes.info(format!("{name} says that it is in mode {mode}"));
                }
                match (self.is_armed(), armed) {
                    (false, true) => notes.warn(format!("{name} says that it is armed")),
                    (true, false) => notes.warn(format!("{name} says that it is disarmed")),
                    _ => {}
                }
            }
        }
        self.mode = mode;
        self.vehicle = Some((header, answers_at));
        self.readiness.set_armed(armed);
    }
}
