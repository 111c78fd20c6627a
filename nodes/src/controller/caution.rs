//! Reaction of the controller to findings of the mirror.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Finding, FindingStage};

use crate::config::{NodeConfig, OnFinding};
use crate::error::NodeError;
use crate::notices::{Notice, say};
use crate::ports::receive;

/// Queue length for findings.
const DEPTH: usize = 64;

/// Withholds commands from the first finding that the prediction fails until it is correct again. Plant,
/// estimator and bridges recognise a controller without a usable command, and go to their failsafe.
pub(super) struct Caution {
    findings: Option<Subscriber<Finding>>,
    is_wrong: bool,
}

impl Caution {
    pub(super) fn open(bus: &Bus, config: &NodeConfig) -> Result<Self, NodeError> {
        let wanted = config.mirror.is_some_and(|m| m.on_finding == OnFinding::Failsafe);
        Ok(Self { findings: if wanted { Some(bus.subscriber(DEPTH)?) } else { None }, is_wrong: false })
    }

    pub(super) fn forget(&mut self) {
        self.is_wrong = false;
    }

    /// True when the command of a step must be withheld.
    pub(super) fn withholds(&mut self, step: u64, refused: &mut u64) -> Result<bool, NodeError> {
        let Some(findings) = &mut self.findings else { return Ok(false) };
        let before = self.is_wrong;
        while let Some(finding) = receive(findings, refused)? {
            self.is_wrong = finding.stage != FindingStage::Over as u32;
        }
        if self.is_wrong != before {
            say(Notice::Caution { step, withholds: self.is_wrong });
        }
        Ok(self.is_wrong)
    }
}
