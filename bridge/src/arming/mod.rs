//! Arming: decides whether nobody, the pilot or the controller drives the outputs, and gives the reason.
//!
//! - Outputs are neutral until an explicit arm, and arming needs every condition of [`Conditions`].
//! - The pilot's switch selects manual or automatic, and always has priority.
//! - A condition that fails in automatic ends it at once and permanently: until the arm is removed and given
//!   again, or the pilot takes over. [`Policy::recover_after`] is the one exception, for a bench without a
//!   pilot.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Event that arms the outputs.
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

/// Options of arming from the launch file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Policy {
    /// Event that arms the outputs.
    pub arm: ArmBy,
    /// Largest age of measurements for flight.
    pub stale: Duration,
    /// With [`ArmBy::Start`]: rearms after the conditions held for this time.
    pub recover_after: Option<Duration>,
}

/// Current conditions for arming.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions {
    /// State of the arm switch or of the autopilot's report; unused with [`ArmBy::Start`].
    pub arm: bool,
    /// True once that state was received since the bridge started: before it, `arm` is false.
    pub arm_is_known: bool,
    /// True while messages from the vehicle arrive.
    pub link: bool,
    /// Age of the attitude; `None` before the first.
    pub data_age: Option<Duration>,
    /// Typical time between two attitudes; `None` before several have arrived.
    pub data_interval: Option<Duration>,
    /// True while the vehicle's own failsafe is inactive.
    pub vehicle_well: bool,
    /// True while outputs can be sent.
    pub outputs: bool,
    /// True while commands arrive in time.
    pub commands: bool,
    /// True when the last command was finite.
    pub finite: bool,
    /// True while the estimate is consistent with the measurements.
    pub estimate: bool,
    /// True while no axis turns opposite to its command.
    pub signs: bool,
    /// State of the pilot's stick; `None` without a pilot.
    pub pilot: Option<PilotView>,
}

/// State of the pilot's stick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PilotView {
    /// True when the stick is received and its receiver is not in failsafe.
    pub present: bool,
    /// True when roll and pitch are centred.
    pub neutral: bool,
    /// True when the mode switch is at automatic.
    pub automatic: bool,
}

/// Reason why the controller is not in charge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// Arming was not requested.
    #[error("nobody has armed")]
    NotArmed,
    /// No messages from the vehicle.
    #[error("the link to the vehicle is down")]
    LinkDown,
    /// The newest attitude is too old.
    #[error("the vehicle's attitude is stale")]
    Stale,
    /// The vehicle reports a failsafe or an emergency.
    #[error("the vehicle reports a failsafe")]
    VehicleFailsafe,
    /// No command arrived in time.
    #[error("commands arrive too late")]
    NoCommand,
    /// A command was not finite.
    #[error("the controller commanded something that is not a number")]
    NotFinite,
    /// The estimate is inconsistent with the measurements.
    #[error("the estimator diverges from what is measured")]
    Diverged,
    /// An axis turns opposite to its command.
    #[error(
        "the vehicle answers its commands with the wrong sign; whirlstand bridge check finds the channel"
    )]
    WrongSign,
    /// The pilot's stick is not received.
    #[error("no messages arrive from the pilot's stick")]
    PilotLost,
    /// The stick is not centred.
    #[error("the pilot's stick is not in the middle")]
    StickNotNeutral,
    /// This bridge was restarted during a run.
    #[error("the bridge was restarted: arm it again")]
    BridgeRestarted,
    /// The vehicle's clock went back.
    #[error("the vehicle restarted")]
    Restarted,
    /// The attitude is so infrequent that after a single loss it is too old.
    #[error("the vehicle's attitude arrives too rarely")]
    TooRare,
    /// Outputs do not leave.
    #[error("the outputs cannot be sent: their line is closed or full")]
    OutputDown,
}

impl Reason {
    /// Every reason, in the order of their numbers.
    pub const ALL: [Self; 14] = [
        Self::NotArmed,
        Self::LinkDown,
        Self::Stale,
        Self::VehicleFailsafe,
        Self::NoCommand,
        Self::NotFinite,
        Self::Diverged,
        Self::WrongSign,
        Self::PilotLost,
        Self::StickNotNeutral,
        Self::BridgeRestarted,
        Self::Restarted,
        Self::TooRare,
        Self::OutputDown,
    ];

    /// Number of the reason in logs; 0 is none. New reasons come last, so that old logs keep their meaning.
    pub fn number(self) -> u32 {
        self as u32 + 1
    }
}

/// Mode of arming: the source that drives the outputs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Nobody drives the outputs, which are neutral.
    Disarmed,
    /// The pilot drives the outputs.
    Manual,
    /// The controller drives the outputs.
    Automatic,
    /// A condition failed in flight: the outputs are neutral, or handed over to the vehicle's own pilot.
    Failed(Reason),
}

/// State machine of arming: decides which source drives the outputs.
#[derive(Debug, Clone)]
pub struct Arming {
    policy: Policy,
    mode: Mode,
    /// True after the arm was off, so that a later on counts.
    seen_off: bool,
    /// True after this bridge was restarted during a run, until the arm was off.
    came_back: bool,
    /// Condition that prevented a requested arm.
    refused: Option<Reason>,
    good_since: Option<Duration>,
}

impl Arming {
    /// A disarmed state machine.
    pub fn new(policy: Policy) -> Self {
        // An autopilot may be in the air when the bench starts; a switch must be moved.
        let seen_off = policy.arm != ArmBy::Switch;
        Self { policy, mode: Mode::Disarmed, seen_off, came_back: false, refused: None, good_since: None }
    }

    /// The current mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The first condition of the last update that prevents arming; `None` when nothing does.
    pub fn refused(&self) -> Option<Reason> {
        self.refused
    }

    /// Evaluates the conditions; returns the new mode when it changed.
    pub fn update(&mut self, c: &Conditions, now: Duration) -> Option<Mode> {
        let asked = c.arm || self.policy.arm == ArmBy::Start;
        let broken = self.broken(c);
        self.good_since = match broken {
            None => self.good_since.or(Some(now)),
            Some(_) => None,
        };
        // A bridge that came back has to hear of the disarm: what it has not yet received is none.
        let waits = self.came_back && !c.arm_is_known;
        let next = match self.mode {
            _ if !asked && !waits => self.put_down(),
            Mode::Disarmed => self.try_to_arm(c, broken),
            Mode::Automatic | Mode::Manual => self.in_charge(c, broken),
            Mode::Failed(reason) => self.after_failure(c, reason, broken, now),
        };
        let changed = next != self.mode;
        self.mode = next;
        changed.then_some(next)
    }

    /// Begins during a run, because the previous bridge died: a previous arm does not count any more.
    pub fn come_back(&mut self) -> Mode {
        self.mode = Mode::Failed(Reason::BridgeRestarted);
        self.came_back = true;
        self.good_since = None;
        self.mode
    }

    /// Disarms because the vehicle restarted; returns the new mode when it changed.
    pub fn restarted(&mut self) -> Option<Mode> {
        if self.mode == Mode::Disarmed {
            return None;
        }
        self.mode = Mode::Failed(Reason::Restarted);
        self.good_since = None;
        Some(self.mode)
    }

    /// Disarms at the end of the run; returns the new mode when it changed.
    pub fn end(&mut self) -> Option<Mode> {
        let changed = self.mode != Mode::Disarmed;
        self.mode = self.put_down();
        changed.then_some(self.mode)
    }

    fn put_down(&mut self) -> Mode {
        self.seen_off = true;
        self.came_back = false;
        self.refused = Some(Reason::NotArmed);
        Mode::Disarmed
    }

    fn try_to_arm(&mut self, c: &Conditions, broken: Option<Reason>) -> Mode {
        let stick = c.pilot.is_some_and(|p| !p.neutral).then_some(Reason::StickNotNeutral);
        let rare = c.data_interval.is_some_and(|interval| 2 * interval > self.policy.stale);
        self.refused = broken.or(rare.then_some(Reason::TooRare)).or(stick);
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
        // The loss of the pilot, who could have taken over, is reported even after another failure.
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
            (c.outputs, Reason::OutputDown),
            (c.finite, Reason::NotFinite),
            (c.signs, Reason::WrongSign),
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
