//! Messages of PX4 to all: its heartbeats, and the reasons why it does not arm.

use crate::mavlink::dialect::{HEARTBEAT_DATA, MavAutopilot, MavModeFlag};
use crate::mavlink::{Header, MavMessage, Readiness};
use crate::note::Notes;

/// State from PX4's heartbeats and reports.
#[derive(Debug, Clone)]
pub(super) struct Heard {
    /// Identity of the vehicle from its heartbeats, and the port on which they last arrived.
    vehicle: Option<(Header, usize)>,
    readiness: Readiness,
}

impl Default for Heard {
    fn default() -> Self {
        Self { vehicle: None, readiness: Readiness::new("PX4") }
    }
}

impl Heard {
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
        match self.vehicle {
            None => notes.warn(format!(
                "PX4 is system {}, component {}, and says that it is {}",
                header.system,
                header.component,
                if armed { "armed" } else { "not armed" }
            )),
            // Other components have their own heartbeats.
            Some((known, _)) if (known.system, known.component) != (header.system, header.component) => {
                return;
            }
            Some(_) if self.is_armed() == armed => {}
            Some(_) if armed => notes.warn("PX4 says that it is armed"),
            Some(_) => notes.warn("PX4 says that it is disarmed"),
        }
        self.vehicle = Some((header, answers_at));
        self.readiness.set_armed(armed);
    }
}
