//! Who is in charge of the outputs: nobody, the pilot, or the controller; and why not.
//!
//! - Outputs are neutral until an explicit arm, and arming needs every condition of [`Conditions`].
//! - The pilot's switch decides between manual and automatic, and always wins.
//! - A condition that breaks in automatic ends it at once and for good: until the arm is taken off and given again,
//!   or the pilot takes over. [`Policy::recover_after`] is the one exception, for a bench without a pilot.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// What arms.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ArmBy {
    /// The pilot's arm switch: off, then on while every condition holds.
    Switch,
    /// The autopilot reports that it is armed.
    Autopilot,
    /// The start of the run: armed as soon as every condition holds.
    Start,
}

/// What the user asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Policy {
    /// What arms.
    pub arm: ArmBy,
    /// Oldest data that is flown on.
    pub stale: Duration,
    /// With [`ArmBy::Start`]: arms again after the conditions held for so long.
    pub recover_after: Option<Duration>,
}

/// How things stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions {
    /// The arm switch or the autopilot's report; unused with [`ArmBy::Start`].
    pub arm: bool,
    /// The vehicle is heard.
    pub link: bool,
    /// Age of the attitude; `None` before the first.
    pub data_age: Option<Duration>,
    /// The vehicle's own failsafe is not active.
    pub vehicle_well: bool,
    /// Commands come in time.
    pub commands: bool,
    /// The last command was finite.
    pub finite: bool,
    /// The estimate follows the measurements.
    pub estimate: bool,
    /// The pilot; `None` without one.
    pub pilot: Option<PilotView>,
}

/// What the pilot does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PilotView {
    /// The stick is heard, and its receiver is not in failsafe.
    pub present: bool,
    /// Roll and pitch stand in the middle.
    pub neutral: bool,
    /// The switch stands at automatic.
    pub automatic: bool,
}

/// Why the controller is not in charge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// Nobody armed.
    #[error("nobody has armed")]
    NotArmed,
    /// The vehicle is not heard.
    #[error("the link to the vehicle is down")]
    LinkDown,
    /// The newest attitude is too old.
    #[error("the vehicle's attitude is stale")]
    Stale,
    /// The vehicle reports a failsafe or an emergency of its own.
    #[error("the vehicle reports a failsafe")]
    VehicleFailsafe,
    /// No command came in time.
    #[error("commands do not come in time")]
    NoCommand,
    /// A command was not finite.
    #[error("the controller commanded something that is not a number")]
    NotFinite,
    /// The estimate left the measurements.
    #[error("the estimator diverges from what is measured")]
    Diverged,
    /// The pilot's stick is not heard.
    #[error("the pilot's stick is not heard")]
    PilotLost,
    /// The stick is not in the middle.
    #[error("the pilot's stick is not in the middle")]
    StickNotNeutral,
    /// The vehicle's clock went back.
    #[error("the vehicle restarted")]
    Restarted,
}

/// Who is in charge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Nobody: neutral.
    Disarmed,
    /// The pilot.
    Manual,
    /// The controller.
    Automatic,
    /// Nobody: something broke. Neutral, or handed over to the vehicle's own pilot.
    Failed(Reason),
}

/// Decides who is in charge.
#[derive(Debug, Clone)]
pub struct Arming {
    policy: Policy,
    mode: Mode,
    /// The arm was seen off, so that on now means something.
    seen_off: bool,
    /// What stood in the way of an arm that was asked for.
    refused: Option<Reason>,
    good_since: Option<Duration>,
}

impl Arming {
    /// Nobody in charge.
    pub fn new(policy: Policy) -> Self {
        // An autopilot may be in the air when the bench starts; a switch must be moved.
        let seen_off = policy.arm != ArmBy::Switch;
        Self { policy, mode: Mode::Disarmed, seen_off, refused: None, good_since: None }
    }

    /// Who is in charge.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// What stands in the way of arming now, of those that were looked at last.
    pub fn refused(&self) -> Option<Reason> {
        self.refused
    }

    /// Looks at the conditions; returns the new mode when it changed.
    pub fn update(&mut self, c: &Conditions, now: Duration) -> Option<Mode> {
        let asked = c.arm || self.policy.arm == ArmBy::Start;
        let broken = self.broken(c);
        self.good_since = match broken {
            None => self.good_since.or(Some(now)),
            Some(_) => None,
        };
        let next = match self.mode {
            _ if !asked => self.put_down(),
            Mode::Disarmed => self.try_to_arm(c, broken),
            Mode::Automatic | Mode::Manual => self.in_charge(c, broken),
            Mode::Failed(reason) => self.after_failure(c, reason, broken, now),
        };
        let changed = next != self.mode;
        self.mode = next;
        changed.then_some(next)
    }

    /// The vehicle began anew: what was armed is not.
    pub fn restarted(&mut self) -> Option<Mode> {
        if self.mode == Mode::Disarmed {
            return None;
        }
        self.mode = Mode::Failed(Reason::Restarted);
        self.good_since = None;
        Some(self.mode)
    }

    /// Nobody is in charge any more; returns the new mode when it changed.
    pub fn end(&mut self) -> Option<Mode> {
        let changed = self.mode != Mode::Disarmed;
        self.mode = self.put_down();
        changed.then_some(self.mode)
    }

    fn put_down(&mut self) -> Mode {
        self.seen_off = true;
        self.refused = Some(Reason::NotArmed);
        Mode::Disarmed
    }

    fn try_to_arm(&mut self, c: &Conditions, broken: Option<Reason>) -> Mode {
        let stick = c.pilot.is_some_and(|p| !p.neutral).then_some(Reason::StickNotNeutral);
        self.refused = broken.or(stick);
        match self.refused {
            None if self.seen_off => in_charge_by_switch(c),
            None => {
                self.refused = Some(Reason::NotArmed);
                Mode::Disarmed
            }
            Some(_) => {
                // A switch that was moved too early must be moved again.
                if self.policy.arm == ArmBy::Switch {
                    self.seen_off = false;
                }
                Mode::Disarmed
            }
        }
    }

    fn in_charge(&mut self, c: &Conditions, broken: Option<Reason>) -> Mode {
        match (in_charge_by_switch(c), broken) {
            (Mode::Manual, _) if c.pilot.is_some_and(|p| p.present) => Mode::Manual,
            (_, Some(reason)) => Mode::Failed(reason),
            (mode, None) => mode,
        }
    }

    fn after_failure(
        &mut self,
        c: &Conditions,
        reason: Reason,
        broken: Option<Reason>,
        now: Duration,
    ) -> Mode {
        self.refused = broken.or(Some(reason));
        if c.pilot.is_some_and(|p| p.present && !p.automatic) {
            return Mode::Manual;
        }
        // Who could have taken over is gone too: that is worth telling, whatever broke first.
        if broken == Some(Reason::PilotLost) && reason != Reason::PilotLost {
            return Mode::Failed(Reason::PilotLost);
        }
        let held = self.good_since.is_some_and(|since| {
            self.policy.recover_after.is_some_and(|wait| now.saturating_sub(since) >= wait)
        });
        if held && self.policy.arm == ArmBy::Start { in_charge_by_switch(c) } else { self.mode }
    }

    fn broken(&self, c: &Conditions) -> Option<Reason> {
        [
            (c.pilot.is_none_or(|p| p.present), Reason::PilotLost),
            (c.link, Reason::LinkDown),
            (c.data_age.is_some_and(|age| age <= self.policy.stale), Reason::Stale),
            (c.vehicle_well, Reason::VehicleFailsafe),
            (c.finite, Reason::NotFinite),
            (c.commands, Reason::NoCommand),
            (c.estimate, Reason::Diverged),
        ]
        .into_iter()
        .find_map(|(good, reason)| (!good).then_some(reason))
    }
}

/// Without a pilot the controller is in charge.
fn in_charge_by_switch(c: &Conditions) -> Mode {
    if c.pilot.is_none_or(|p| p.automatic) { Mode::Automatic } else { Mode::Manual }
}

#[cfg(test)]
mod tests;
