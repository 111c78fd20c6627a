//! The law in charge, and its replacement in flight.
//!
//! A new law runs in parallel for a quarter of a second and at least as long as its memory, then takes over
//! without a bump ([`Controller::fly_along`](whirlstand_control::Controller::fly_along)). The first law is
//! kept, and returns in the same way.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Finding, FindingStage, MAX_INPUTS, Setpoint, flags};

use super::draftsman::{Draft, Draftsman};
use super::law::Law;
use crate::config::{Mode, NodeConfig, OnFinding};
use crate::error::NodeError;
use crate::notices::{Notice, say};
use crate::ports::receive;
use crate::setup::Setup;
use crate::succession::{ready_at, steps};

/// Queue length for findings.
const DEPTH: usize = 64;

/// Shortest time for which a law runs in parallel, s: several time constants of an actuator.
const ALONG_S: f64 = 0.25;

/// A law that will take over.
struct Coming {
    law: Law,
    is_first: bool,
    /// First step in parallel, and first step in charge.
    along: u64,
    from: u64,
}

/// State of the replacement of laws.
struct Heirs {
    findings: Subscriber<Finding>,
    draftsman: Draftsman,
    /// Step from which the law being designed is waited for in lockstep; `None` while none is designed.
    ordered: Option<u64>,
    coming: Option<Coming>,
    /// The first law, while another is in charge.
    first: Option<Law>,
    waits: bool,
    along: u64,
}

/// The law in charge, with its possible replacement.
pub(super) struct InCharge {
    law: Law,
    heirs: Option<Heirs>,
}

impl InCharge {
    /// The first law, and a design thread where the launch file allows other laws.
    pub(super) fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let wanted = config.mirror.is_some_and(|m| m.on_finding == OnFinding::Law);
        let heirs = || {
            Ok::<_, NodeError>(Heirs {
                findings: bus.subscriber(DEPTH)?,
                draftsman: Draftsman::new(config, setup)?,
                ordered: None,
                coming: None,
                first: None,
                waits: config.mode == Mode::Lockstep,
                along: steps(config, ALONG_S),
            })
        };
        Ok(Self { law: Law::new(config, setup)?, heirs: wanted.then(heirs).transpose()? })
    }

    /// The law in charge.
    pub(super) fn law(&mut self) -> &mut Law {
        &mut self.law
    }

    /// Computes the inputs for the next period from the estimated states of a step, or takes those that are
    /// given `by_hand`; returns the command's flags.
    pub(super) fn step(
        &mut self,
        step: u64,
        x: &[f64],
        setpoint: &Setpoint,
        by_hand: Option<&[f64; MAX_INPUTS]>,
        u: &mut [f64; MAX_INPUTS],
        refused: &mut u64,
    ) -> Result<u32, NodeError> {
        let Some(heirs) = &mut self.heirs else {
            return Ok(self.law.step_or_follow(step, x, setpoint, by_hand, u));
        };
        heirs.hear(refused)?;
        heirs.fetch(step);
        if let Some(coming) = heirs.coming.take_if(|c| step >= c.from) {
            say(Notice::InCharge { step, is_first: coming.is_first });
            let before = std::mem::replace(&mut self.law, coming.law);
            heirs.put_away(before, coming.is_first);
        }
        let flags = self.law.step_or_follow(step, x, setpoint, by_hand, u);
        if let Some(coming) = heirs.coming.as_mut().filter(|c| step >= c.along) {
            coming.law.fly_along(&self.law, x, setpoint);
        }
        Ok(if heirs.first.is_some() { flags | flags::SUCCEEDED } else { flags })
    }

    /// Resets to the first law in its initial state, for a new run.
    pub(super) fn reset(&mut self) {
        if let Some(heirs) = &mut self.heirs {
            heirs.ordered = None;
            heirs.give_up_coming();
            if let Some(first) = heirs.first.take() {
                heirs.draftsman.retire(std::mem::replace(&mut self.law, first));
            }
        }
        self.law.reset();
    }
}

impl Heirs {
    /// Receives findings of the mirror.
    fn hear(&mut self, refused: &mut u64) -> Result<(), NodeError> {
        while let Some(finding) = receive(&mut self.findings, refused)? {
            let ready = ready_at(finding.head.step);
            match FindingStage::from_u32(finding.stage) {
                Some(FindingStage::Law) => {
                    self.give_up_coming();
                    self.draftsman.order(&finding);
                    self.ordered = Some(ready);
                }
                Some(FindingStage::FirstLaw) => {
                    self.ordered = None;
                    self.give_up_coming();
                    if let Some(law) = self.first.take() {
                        self.coming = Some(self.coming(law, true, ready));
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Takes the designed law, if it is ready; in lockstep it is waited for.
    fn fetch(&mut self, step: u64) {
        let Some(ready) = self.ordered.filter(|ready| step >= *ready) else { return };
        match self.draftsman.draft(self.waits) {
            Draft::Ready(law) => {
                self.ordered = None;
                self.coming = Some(self.coming(law, false, ready.max(step)));
            }
            Draft::None => self.ordered = None,
            Draft::Coming => {}
        }
    }

    fn coming(&self, law: Law, is_first: bool, along: u64) -> Coming {
        let from = along + self.along.max(law.memory_steps());
        Coming { law, is_first, along, from }
    }

    fn give_up_coming(&mut self) {
        let Some(coming) = self.coming.take() else { return };
        match coming.is_first {
            true => self.first = Some(coming.law),
            false => self.draftsman.retire(coming.law),
        }
    }

    /// Keeps or frees the previous law.
    fn put_away(&mut self, law: Law, first_flies: bool) {
        if first_flies || self.first.is_some() {
            self.draftsman.retire(law);
        } else {
            self.first = Some(law);
        }
    }
}
