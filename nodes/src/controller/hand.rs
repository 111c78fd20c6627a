//! The stick in the hand of somebody outside: it flies in the place of the law, for as long as it is heard.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, MAX_INPUTS, Message, Stick};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::gate::InputLimits;
use crate::notices::{Notice, say};
use crate::ports::receive;
use crate::succession::steps;

/// Queue for what the hand says.
const DEPTH: usize = 64;

/// Bench time after which a hand that says nothing has let go, s: as for the pilot of a bridge.
const PATIENCE_S: f64 = 0.5;

/// Whose hand it is.
struct Held {
    /// Number of the request with which it was taken over.
    id: u64,
    u: [f64; MAX_INPUTS],
    /// Step at which it was heard last.
    heard: u64,
}

/// A stick that can be taken over.
pub(super) struct Hand {
    said: Subscriber<Stick>,
    held: Option<Held>,
    limits: InputLimits,
    patience: u64,
}

impl Hand {
    pub(super) fn open(bus: &Bus, config: &NodeConfig, limits: InputLimits) -> Result<Self, NodeError> {
        let patience = steps(config, PATIENCE_S).max(2);
        Ok(Self { said: bus.subscriber(DEPTH)?, held: None, limits, patience })
    }

    /// Takes it over (1) or gives it back (0), which anybody may. Until the hand says something it holds what was commanded
    /// last.
    pub(super) fn adjust(
        &mut self,
        request: &Adjustment,
        step: u64,
        before: &[f64; MAX_INPUTS],
    ) -> AdjustmentVerdict {
        match (request.value, &self.held) {
            (0.0, _) => {
                self.held = None;
                AdjustmentVerdict::Done
            }
            (1.0, Some(held)) if held.id != request.id => AdjustmentVerdict::Busy,
            (1.0, _) => {
                self.held = Some(Held { id: request.id, u: *before, heard: step });
                AdjustmentVerdict::Done
            }
            _ => AdjustmentVerdict::Unusable,
        }
    }

    /// Takes in what the hand says. What it wants beyond a limit is left out as a whole and counted as refused. After a silence
    /// that is too long it has let go, and that is returned to be told.
    pub(super) fn take(&mut self, step: u64, refused: &mut u64) -> Result<Option<Adjustment>, NodeError> {
        // No more than waits: whoever sends without a pause does not keep the step from being taken.
        for _ in 0..DEPTH {
            let Some(said) = receive(&mut self.said, refused)? else { break };
            let Some(held) = self.held.as_mut().filter(|held| held.id == said.id) else { continue };
            if self.limits.allow(&said.u) {
                (held.u, held.heard) = (said.u, step);
            } else {
                *refused += 1;
            }
        }
        let Some(held) = self.held.take_if(|held| step.saturating_sub(held.heard) >= self.patience) else {
            return Ok(None);
        };
        say(Notice::LetGo { step });
        let (what, verdict) = (AdjustmentKind::Stick as u32, AdjustmentVerdict::Done as u32);
        Ok(Some(Adjustment { id: held.id, what, verdict, ..Adjustment::zeroed() }))
    }

    /// What it gives, while it is held.
    pub(super) fn u(&self) -> Option<&[f64; MAX_INPUTS]> {
        self.held.as_ref().map(|held| &held.u)
    }

    /// The plant began a new run, which the law flies.
    pub(super) fn forget(&mut self) {
        self.held = None;
    }
}
