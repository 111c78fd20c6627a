//! What PX4 says to everybody on its line: heartbeats, words, and the summary of its arming checks.

use super::events::ArmingChecks;
use crate::mavlink::dialect::{EVENT_DATA, HEARTBEAT_DATA, MavAutopilot, MavModeFlag, STATUSTEXT_DATA};
use crate::mavlink::{Header, status_text};
use crate::note::Notes;

/// What was heard.
#[derive(Debug, Clone, Default)]
pub(super) struct Heard {
    /// Who the vehicle is, and whether it is armed, by its heartbeats.
    vehicle: Option<(Header, bool)>,
    words: Option<String>,
    checks: Option<ArmingChecks>,
    /// What the arming checks and the words say together.
    said: Option<String>,
}

impl Heard {
    /// Who the vehicle is.
    pub(super) fn vehicle(&self) -> Option<Header> {
        self.vehicle.map(|(header, _)| header)
    }

    /// Whether its heartbeats say that it is armed.
    pub(super) fn is_armed(&self) -> bool {
        self.vehicle.is_some_and(|(_, armed)| armed)
    }

    /// Why it is not armed, as far as it said.
    pub(super) fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    pub(super) fn beat(&mut self, header: Header, beat: &HEARTBEAT_DATA, notes: &mut Notes) {
        if beat.autopilot == MavAutopilot::MAV_AUTOPILOT_INVALID {
            return;
        }
        let armed = beat.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        match self.vehicle {
            None => notes.warn(format!(
                "PX4 is system {}, component {}, and says that it is {}",
                header.system,
                header.component,
                if armed { "armed" } else { "not armed" }
            )),
            // Other components have heartbeats of their own.
            Some((known, _)) if (known.system, known.component) != (header.system, header.component) => {
                return;
            }
            Some((_, before)) if before == armed => return,
            Some(_) if armed => notes.warn("PX4 says that it is armed"),
            Some(_) => notes.warn("PX4 says that it is disarmed"),
        }
        self.vehicle = Some((header, armed));
    }

    pub(super) fn words(&mut self, m: &STATUSTEXT_DATA, notes: &mut Notes) {
        let Some((warn, text)) = status_text(m).filter(|(_, text)| self.words.as_ref() != Some(text)) else {
            return;
        };
        let told = format!("PX4 says: {text}");
        if warn {
            notes.warn(told);
        } else {
            notes.info(told);
        }
        self.words = Some(text);
        self.put_together();
    }

    pub(super) fn event(&mut self, event: &EVENT_DATA, notes: &mut Notes) {
        let Some(checks) = ArmingChecks::of(event).filter(|checks| self.checks != Some(*checks)) else {
            return;
        };
        let failed_before = self.checks.is_some_and(|before| before.reason().is_some());
        match checks.reason() {
            // In flight they are about the modes that it could go to.
            Some(_) if self.is_armed() => {}
            Some(reason) => notes.warn(format!("PX4 cannot be armed: {reason}")),
            None if failed_before => notes.info("PX4 can be armed: its arming checks pass"),
            None => {}
        }
        self.checks = Some(checks);
        self.put_together();
    }

    fn put_together(&mut self) {
        let checks = self.checks.and_then(ArmingChecks::reason);
        let parts: Vec<_> = checks.into_iter().chain(self.words.clone()).collect();
        self.said = (!parts.is_empty()).then(|| parts.join("; "));
    }
}
