//! Collects reasons why an autopilot does not arm from its MAVLink messages: its texts, of which ArduPilot's name
//! the checks that fail, PX4's summary of its arming checks (an EVENT), the health bits of SYS_STATUS, the state in
//! EXTENDED_SYS_STATE, and its answer to a command to arm.

use super::MavMessage;
use super::arming_checks::ArmingChecks;
use super::dialect::{
    COMMAND_ACK_DATA, EVENT_DATA, EXTENDED_SYS_STATE_DATA, MavCmd, MavLandedState, MavResult,
    STATUSTEXT_DATA, SYS_STATUS_DATA,
};
use super::health::Health;
use super::prearm::PreArm;
use super::status_text::StatusTexts;
use crate::note::Notes;

/// Reported readiness of an autopilot. Each change is reported once.
#[derive(Debug, Clone)]
pub struct Readiness {
    name: &'static str,
    /// True when its heartbeats report that it is armed.
    armed: bool,
    texts: StatusTexts,
    words: Option<String>,
    prearm: PreArm,
    checks: Option<ArmingChecks>,
    health: Option<Health>,
    in_air: bool,
    refusal: Option<&'static str>,
    /// All reasons in one line.
    said: Option<String>,
}

impl Readiness {
    /// State without any report; `name` is the autopilot's name in notes.
    pub fn new(name: &'static str) -> Self {
        Self {
            name,
            armed: false,
            texts: StatusTexts::default(),
            words: None,
            prearm: PreArm::default(),
            checks: None,
            health: None,
            in_air: false,
            refusal: None,
            said: None,
        }
    }

    /// Reported reason why it is not armed.
    pub fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    /// True when its heartbeats report that it is armed.
    pub fn is_armed(&self) -> bool {
        self.armed
    }

    /// Sets the armed state of its heartbeats, which clears earlier refusals when armed.
    pub fn set_armed(&mut self, armed: bool) {
        self.armed = armed;
        if armed {
            self.refusal = None;
            self.prearm.clear();
            self.put_together();
        }
    }

    /// Its arming checks are requested anew: what they do not report again holds no longer.
    pub fn asked(&mut self) {
        self.prearm.asked();
        self.put_together();
    }

    /// Processes a message of the autopilot.
    pub fn hear(&mut self, message: &MavMessage, notes: &mut Notes) {
        match message {
            MavMessage::STATUSTEXT(m) => self.words(m, notes),
            MavMessage::EVENT(m) => self.event(m, notes),
            MavMessage::SYS_STATUS(m) => self.status(m, notes),
            MavMessage::EXTENDED_SYS_STATE(m) => self.landed(m, notes),
            MavMessage::COMMAND_ACK(m) => self.answer(m, notes),
            _ => return,
        }
        self.put_together();
    }

    fn words(&mut self, m: &STATUSTEXT_DATA, notes: &mut Notes) {
        let Some((warn, text)) = self.texts.take(m) else { return };
        let prearm = self.prearm.take(&text);
        if prearm.unwrap_or_else(|| self.words.as_ref() != Some(&text)) {
            let told = format!("{} says: {text}", self.name);
            if warn {
                notes.warn(told);
            } else {
                notes.info(told);
            }
        }
        if prearm.is_none() {
            self.words = Some(text);
        }
    }

    fn event(&mut self, event: &EVENT_DATA, notes: &mut Notes) {
        let Some(checks) = ArmingChecks::of(event).filter(|checks| self.checks != Some(*checks)) else {
            return;
        };
        let failed_before = self.checks.is_some_and(|before| before.reason().is_some());
        match checks.reason() {
            // In flight the checks concern the modes to which it could change.
            Some(_) if self.armed => {}
            Some(reason) => notes.warn(format!("{} cannot be armed: {reason}", self.name)),
            None if failed_before => {
                notes.info(format!("{} can be armed: its arming checks pass", self.name));
            }
            None => {}
        }
        self.checks = Some(checks);
    }

    fn status(&mut self, m: &SYS_STATUS_DATA, notes: &mut Notes) {
        let health = Health::of(m);
        if self.health == Some(health) {
            return;
        }
        self.health = Some(health);
        // The summary of the checks contains the same, and more.
        if let Some(reason) = health.reason().filter(|_| !self.armed && self.checks.is_none()) {
            notes.warn(format!("{} cannot be armed: {reason}", self.name));
        }
    }

    fn landed(&mut self, m: &EXTENDED_SYS_STATE_DATA, notes: &mut Notes) {
        use MavLandedState as State;
        let in_air = matches!(
            m.landed_state,
            State::MAV_LANDED_STATE_IN_AIR
                | State::MAV_LANDED_STATE_TAKEOFF
                | State::MAV_LANDED_STATE_LANDING
        );
        if in_air && !self.in_air && !self.armed {
            notes.warn(format!("{} is not armed and reports that it is in the air", self.name));
        }
        self.in_air = in_air;
    }

    fn answer(&mut self, m: &COMMAND_ACK_DATA, notes: &mut Notes) {
        if m.command != MavCmd::MAV_CMD_COMPONENT_ARM_DISARM || self.armed {
            return;
        }
        use MavResult as Answer;
        let refusal = match m.result {
            Answer::MAV_RESULT_ACCEPTED | Answer::MAV_RESULT_IN_PROGRESS => None,
            Answer::MAV_RESULT_TEMPORARILY_REJECTED => Some("temporarily rejected"),
            Answer::MAV_RESULT_DENIED => Some("denied"),
            Answer::MAV_RESULT_UNSUPPORTED => Some("unsupported"),
            Answer::MAV_RESULT_FAILED => Some("failed"),
            Answer::MAV_RESULT_CANCELLED => Some("cancelled"),
            Answer::MAV_RESULT_NOT_IN_CONTROL => Some("another station is in control"),
            _ => Some("the command was malformed"),
        };
        if let Some(why) = refusal.filter(|_| refusal != self.refusal) {
            notes.warn(format!("{} refuses the command to arm: {why}", self.name));
        }
        self.refusal = refusal;
    }

    fn put_together(&mut self) {
        // The summary of the checks contains the health bits, and more.
        let checks = match self.checks {
            Some(checks) => checks.reason(),
            None => self.health.and_then(Health::reason),
        };
        let in_air = self.in_air.then(|| "it reports that it is in the air".to_string());
        let refusal = self.refusal.map(|why| format!("it refuses the command to arm: {why}"));
        let mut parts: Vec<_> = [checks, in_air, refusal].into_iter().flatten().collect();
        parts.extend(self.prearm.texts().map(String::from));
        // Its last words may be about anything: those on its checks count more.
        parts.extend(self.words.clone().filter(|_| self.prearm.texts().next().is_none()));
        self.said = (!parts.is_empty()).then(|| parts.join("; "));
    }
}

#[cfg(test)]
mod tests {
    use super::super::dialect::MavSysStatusSensor as Sensor;
    use super::*;

    fn told(readiness: &mut Readiness, message: &MavMessage) -> Vec<String> {
        let mut notes = Notes::default();
        readiness.hear(message, &mut notes);
        std::iter::from_fn(|| notes.take()).map(|note| note.text).collect()
    }

    fn answer(result: MavResult) -> MavMessage {
        let command = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
        MavMessage::COMMAND_ACK(COMMAND_ACK_DATA { command, result, ..Default::default() })
    }

    fn status(health: Sensor) -> MavMessage {
        let used = Sensor::MAV_SYS_STATUS_SENSOR_GPS | Sensor::MAV_SYS_STATUS_PREARM_CHECK;
        MavMessage::SYS_STATUS(SYS_STATUS_DATA {
            onboard_control_sensors_present: used,
            onboard_control_sensors_enabled: used,
            onboard_control_sensors_health: health,
            ..Default::default()
        })
    }

    #[test]
    fn a_command_to_arm_that_is_refused_is_told_until_it_is_armed() {
        let mut readiness = Readiness::new("PX4");
        assert_eq!(
            told(&mut readiness, &answer(MavResult::MAV_RESULT_DENIED)),
            ["PX4 refuses the command to arm: denied"]
        );
        assert!(told(&mut readiness, &answer(MavResult::MAV_RESULT_DENIED)).is_empty(), "once");
        assert_eq!(readiness.said(), Some("it refuses the command to arm: denied"));
        readiness.set_armed(true);
        assert_eq!(readiness.said(), None);
        let disarm_refused = answer(MavResult::MAV_RESULT_DENIED);
        assert!(told(&mut readiness, &disarm_refused).is_empty(), "in flight it refuses to disarm");
        let other = MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            result: MavResult::MAV_RESULT_DENIED,
            ..Default::default()
        });
        readiness.set_armed(false);
        assert!(told(&mut readiness, &other).is_empty());
    }

    #[test]
    fn health_bits_are_told_where_no_summary_of_the_checks_came() {
        let mut readiness = Readiness::new("the vehicle");
        let words = "its pre-arm checks fail; not healthy: GPS";
        assert_eq!(
            told(&mut readiness, &status(Sensor::empty())),
            [format!("the vehicle cannot be armed: {words}")]
        );
        assert!(told(&mut readiness, &status(Sensor::empty())).is_empty(), "once");
        assert_eq!(readiness.said(), Some(words));
        assert!(told(&mut readiness, &status(Sensor::all())).is_empty());
        assert_eq!(readiness.said(), None, "all is well");
    }

    #[test]
    fn one_that_believes_that_it_flies_says_so() {
        let mut readiness = Readiness::new("PX4");
        let landed = |landed_state| {
            MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA { landed_state, ..Default::default() })
        };
        let in_air = landed(MavLandedState::MAV_LANDED_STATE_IN_AIR);
        assert_eq!(told(&mut readiness, &in_air), ["PX4 is not armed and reports that it is in the air"]);
        assert!(told(&mut readiness, &in_air).is_empty(), "once");
        assert_eq!(readiness.said(), Some("it reports that it is in the air"));
        told(&mut readiness, &landed(MavLandedState::MAV_LANDED_STATE_ON_GROUND));
        assert_eq!(readiness.said(), None);
    }

    fn says(readiness: &mut Readiness, text: &str) -> Vec<String> {
        let severity = super::super::dialect::MavSeverity::MAV_SEVERITY_CRITICAL;
        let text = STATUSTEXT_DATA { severity, text: text.into(), ..Default::default() };
        told(readiness, &MavMessage::STATUSTEXT(text))
    }

    #[test]
    fn every_check_that_ardupilot_names_is_a_reason_until_it_passes() {
        let mut readiness = Readiness::new("ArduPilot");
        let (rc, compass) = ("PreArm: RC not calibrated", "PreArm: Compass not calibrated");
        assert_eq!(says(&mut readiness, rc), ["ArduPilot says: PreArm: RC not calibrated"]);
        says(&mut readiness, compass);
        says(&mut readiness, "GPS 1: detected u-blox");
        let both = format!("{rc}; {compass}");
        assert_eq!(readiness.said(), Some(&*both), "and nothing of a receiver");
        // The checks are reported again at each request, but told once.
        for _ in 0..3 {
            readiness.asked();
            assert!(says(&mut readiness, rc).is_empty());
            assert!(says(&mut readiness, compass).is_empty());
            assert_eq!(readiness.said(), Some(&*both));
        }
        // The compass passes.
        for _ in 0..2 {
            readiness.asked();
            says(&mut readiness, rc);
        }
        assert_eq!(readiness.said(), Some(rc));
        says(&mut readiness, "Arm: Mode not armable");
        assert_eq!(readiness.said(), Some(&*format!("Arm: Mode not armable; {rc}")));
        readiness.set_armed(true);
        assert_eq!(readiness.said(), Some("GPS 1: detected u-blox"));
    }
}
