//! Sends outputs to the vehicle and messages to the user.

use std::time::Duration;

use super::{Group, Port, Source, Vehicle, output};
use crate::arming::{Mode, Reason};
use crate::config::{OnFailure, Output, PilotSource};

impl Vehicle {
    /// A change of who is in charge is always told.
    pub(super) fn announce(&mut self, mode: Mode) {
        let text = match mode {
            Mode::Automatic => "armed: the controller is in charge".into(),
            Mode::Manual => "the pilot is in charge".into(),
            Mode::Disarmed => "disarmed: outputs at neutral".into(),
            Mode::Failed(reason) => {
                let what = match self.safety.on_failure {
                    OnFailure::Neutral => "outputs at neutral",
                    OnFailure::Release => "outputs handed over",
                };
                format!("FAILSAFE, {what}: {reason}")
            }
        };
        self.notes.warn(text);
    }

    /// Tells what stands in the way of an arm that was asked for, once for each reason.
    pub(super) fn explain(&mut self, asked: bool) {
        let reason = self
            .arming
            .refused()
            .filter(|r| asked && self.arming.mode() == Mode::Disarmed && *r != Reason::NotArmed);
        if let Some(reason) = reason
            && self.explained != Some(reason)
        {
            self.notes.warn(format!("not armed yet: {reason}"));
        }
        self.explained = reason;
    }

    /// Whether the vehicle's own pilot or failsafe has the vehicle, and nothing is to be sent.
    fn is_handed_over(&self) -> bool {
        match self.arming.mode() {
            Mode::Failed(_) => self.safety.on_failure == OnFailure::Release,
            // The stick of a pilot who flies by the vehicle's own radio needs no relay.
            Mode::Manual => self.pilot_source == Some(PilotSource::Mavlink),
            Mode::Disarmed => self.lent,
            Mode::Automatic => false,
        }
    }

    /// Holds what acts against how the vehicle turns.
    fn watch_signs(&mut self, now: Duration) {
        self.mapping.acting(&mut self.acting);
        if let (Mode::Automatic, Some(angles)) = (self.arming.mode(), self.telemetry.values(Group::Attitude))
        {
            self.signs.observe(&self.acting, angles, self.telemetry.values(Group::Rates), now);
        }
    }

    pub(super) fn send(&mut self, now: Duration) {
        self.sent_at = Some(now);
        let released = self.is_handed_over();
        if released {
            self.mapping.reset();
        } else {
            self.mapping.apply(self.arming.mode(), &self.inputs, self.pilot.as_ref(), now);
            self.watch_signs(now);
        }
        let first_release = released && !std::mem::replace(&mut self.released, released);
        let (us, in_use) = (self.mapping.us(), self.mapping.in_use());
        if let (Source::Mavlink(autopilot), Some(config)) = (&mut self.source, &self.mavlink) {
            let target = autopilot.target();
            let message = match self.output {
                // An override is taken back again and again: the first message may be lost.
                Output::RcOverride => Some(output::rc_override((!released).then_some(us), in_use, target)),
                _ if released => None,
                Output::ManualControl => Some(output::manual_control(us, in_use, target.0)),
                Output::AttitudeTarget => {
                    let yaw = self.telemetry.values(Group::Attitude).map_or(0.0, |[_, _, yaw]| yaw);
                    Some(output::attitude_target(us, in_use, &config.attitude_target, yaw, target, now))
                }
                Output::Crsf | Output::Sbus => None,
            };
            if let Some(message) = message.filter(|_| autopilot.is_known()) {
                autopilot.send(&message, now, &mut self.out[Port::Link as usize]);
                self.outputs += 1;
            }
        }
        self.released = released;
        if released {
            if first_release {
                self.notes.info("the outputs are handed over");
            }
            return;
        }
        let crsf_port = if matches!(self.source, Source::Crsf { .. }) { Port::Link } else { Port::Output };
        match self.output {
            Output::Crsf => output::crsf(us, &mut self.out[crsf_port as usize]),
            Output::Sbus => output::sbus(us, &mut self.out[Port::Output as usize]),
            _ => return,
        }
        self.outputs += 1;
    }
}
