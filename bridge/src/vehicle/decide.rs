//! Decides which source is in charge, from all current conditions.

use std::time::Duration;

use super::{Source, Vehicle};
use crate::arming::{ArmBy, Conditions, Mode, Reason};
use crate::channels::ANGLES;
use crate::pilot::{Axis, Pilot};
use crate::vehicle::Group;

impl Vehicle {
    fn conditions(&self, now: Duration) -> Conditions {
        let (link, well, armed) = match &self.source {
            Source::Mavlink(a) => (a.is_linked(now), a.is_well(), a.is_armed()),
            Source::Crsf { quality, linked_at, timeout, .. } => {
                let linked = linked_at.is_some_and(|at| now.saturating_sub(at) <= *timeout);
                (linked && *quality != Some(0), true, false)
            }
        };
        let pilot = self.pilot.as_ref().map(|p| p.view(now));
        let (arm, arm_is_known) = match self.safety.arm {
            ArmBy::Switch => (self.pilot.as_ref().is_some_and(Pilot::arm), pilot.is_some_and(|p| p.present)),
            ArmBy::Autopilot => (armed, link),
            ArmBy::Start => (true, true),
        };
        Conditions {
            arm,
            arm_is_known,
            link,
            data_age: self.telemetry.age(Group::Attitude, now),
            data_interval: self.telemetry.interval(),
            vehicle_well: well,
            outputs: self.delivery.is_possible(self.command_timeout, now),
            commands: self.command_at.is_some_and(|at| now.saturating_sub(at) <= self.command_timeout),
            finite: self.finite,
            estimate: self.watch.is_good(),
            signs: self.signs.wrong().is_none(),
            pilot,
        }
    }

    pub(super) fn decide(&mut self, now: Duration) {
        let conditions = self.conditions(now);
        let asked = conditions.arm;
        if let Some(mode) = self.arming.update(&conditions, now) {
            if mode == Mode::Automatic {
                self.watch.reset();
            }
            if let (Mode::Failed(Reason::WrongSign), Some(axis)) = (mode, self.signs.wrong()) {
                let axis = Axis::name(ANGLES[axis]);
                self.notes.warn(format!("{axis}: the vehicle accelerates opposite to the command"));
            } else {
                self.signs.reset();
            }
            self.announce(mode);
            self.send(now);
        }
        self.explain(asked);
        self.tell_who_arms(now);
    }
}
