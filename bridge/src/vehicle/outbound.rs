//! Sends outputs to the vehicle and messages to the user.

use std::time::Duration;

use super::{Group, Port, Source, Vehicle, output};
use crate::arming::{ArmBy, Mode, Reason};
use crate::channels::CHANNELS;
use crate::config::{OnFailure, Output, PilotSource};

/// Time without arming after which the awaited source is reported.
const UNARMED: Duration = Duration::from_secs(4);

impl Vehicle {
    /// Reports a change of the source in charge.
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

    /// Reports the condition that prevents a requested arm, once for each reason.
    pub(super) fn explain(&mut self, asked: bool) {
        let reason = self
            .arming
            .refused()
            .filter(|r| asked && self.arming.mode() == Mode::Disarmed && *r != Reason::NotArmed);
        if let Some(reason) = reason
            && self.explained != Some(reason)
        {
            self.notes.warn(self.why_not(reason));
        }
        self.explained = reason;
    }

    /// A reason as text, with its figures.
    fn why_not(&self, reason: Reason) -> String {
        let interval = self.telemetry.interval().filter(|_| reason == Reason::TooRare);
        let Some(interval) = interval else { return format!("not armed yet: {reason}") };
        let (stale_s, interval_s) = (self.safety.stale_s, interval.as_secs_f64());
        format!(
            "not armed yet: {reason}: {:.1} times a second, and bridge.safety.stale_s = {stale_s} needs {:.1} or more, so that one \
             may be lost; raise the telemetry rate of the link, or stale_s to {:.2} where the vehicle is slow enough for it",
            1.0 / interval_s,
            2.0 / stale_s,
            (200.0 * interval_s).ceil() / 100.0
        )
    }

    /// Reports once who must arm, when nobody has armed for a while.
    pub(super) fn tell_who_arms(&mut self, now: Duration) {
        if self.arming.mode() != Mode::Disarmed {
            return self.waiting_since = None;
        }
        let since = *self.waiting_since.get_or_insert(now);
        if self.told_who_arms || now.saturating_sub(since) < UNARMED {
            return;
        }
        self.told_who_arms = true;
        let why = self.arming.refused().filter(|r| *r != Reason::NotArmed);
        let who = match self.safety.arm {
            ArmBy::Switch => "the pilot's arm switch was not moved from off to on",
            ArmBy::Autopilot => {
                "the vehicle says that it is disarmed: its own pilot or ground station arms it"
            }
            ArmBy::Start => "nothing else is needed",
        };
        self.notes.warn(match why {
            Some(reason) => self.why_not(reason),
            None => format!("not armed yet: {who}"),
        });
    }

    /// True when the vehicle is handed over to its own pilot or failsafe, and nothing must be sent.
    fn is_handed_over(&self) -> bool {
        match self.arming.mode() {
            Mode::Failed(_) => self.safety.on_failure == OnFailure::Release,
            // The stick of a pilot who flies by the vehicle's own radio needs no relay.
            Mode::Manual => self.pilot_source == Some(PilotSource::Mavlink),
            // A pilot who has not armed yet keeps all channels.
            Mode::Disarmed => {
                let own_radio =
                    self.pilot_source == Some(PilotSource::Mavlink) && self.output == Output::RcOverride;
                self.lent || own_radio && !self.mapping.is_pushed()
            }
            Mode::Automatic => false,
        }
    }

    /// Channels that may be overridden: all in use, except the pilot's own when he flies by the vehicle's
    /// radio. An autopilot reports overridden channels as the pilot's, so that an override of his throttle
    /// would be fed back and hold it forever.
    pub(super) fn overridden(&self) -> [bool; CHANNELS] {
        let mut overridden = *self.mapping.in_use();
        if self.pilot_source == Some(PilotSource::Mavlink) {
            overridden.iter_mut().zip(self.mapping.pilots()).for_each(|(own, pilots)| *own &= !pilots);
        }
        overridden
    }

    /// Channels that an output carries.
    pub(super) fn carried(&self) -> [bool; CHANNELS] {
        let mut carried = self.overridden();
        match self.output {
            Output::RcOverride => carried,
            Output::ManualControl => {
                carried[4..].fill(false);
                carried
            }
            // A message without a thrust still has a roll, a pitch and a rate of yaw.
            Output::AttitudeTarget => {
                let thrust = self.mapping.in_use()[2];
                std::array::from_fn(|i| if i == 2 { thrust } else { i < 4 })
            }
            // Their frames have all channels, with those that the launch file does not name.
            Output::Crsf | Output::Sbus => [true; CHANNELS],
        }
    }

    pub(super) fn send(&mut self, now: Duration) {
        self.sent_at = Some(now);
        let released = self.is_handed_over();
        if released {
            self.mapping.reset();
        } else {
            self.mapping.apply(self.arming.mode(), &self.inputs, self.pilot.as_ref(), now);
        }
        self.mapping.acting(&mut self.acting);
        let first_release = released && !std::mem::replace(&mut self.released, released);
        let overridden = self.overridden();
        let (us, in_use) = (self.mapping.us(), self.mapping.in_use());
        if let (Source::Mavlink(autopilot), Some(config)) = (&mut self.source, &self.mavlink) {
            let target = autopilot.target();
            let message = match self.output {
                // An override is released repeatedly: the first message may be lost.
                Output::RcOverride => {
                    Some(output::rc_override((!released).then_some(us), &overridden, target))
                }
                _ if released => None,
                Output::ManualControl => Some(output::manual_control(us, &overridden, target.0)),
                Output::AttitudeTarget => {
                    let yaw = self.telemetry.values(Group::Attitude).map_or(0.0, |[_, _, yaw]| yaw);
                    Some(output::attitude_target(us, in_use, &config.attitude_target, yaw, target, now))
                }
                Output::Crsf | Output::Sbus => None,
            };
            if let Some(message) = message.filter(|_| autopilot.is_known()) {
                autopilot.send(&message, now, &mut self.out[Port::Link as usize]);
                self.outputs += 1;
                self.delivery.written();
            }
        }
        self.released = released;
        if released {
            self.delivery.released();
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
        self.delivery.written();
    }
}
