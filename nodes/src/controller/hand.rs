//! Manual control from outside: inputs that replace the law's for as long as they are received.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, MAX_INPUTS, Message, Stick};

use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::gate::InputLimits;
use crate::notices::{Notice, say};
use crate::ports::receive;
use crate::succession::steps;

/// Queue length for stick messages.
const DEPTH: usize = 64;

/// Bench time without a message after which manual control ends, s: as for the pilot of a bridge.
const PATIENCE_S: f64 = 0.5;

/// Sender that has taken over.
struct Held {
    /// Number of the request that took over.
    id: u64,
    u: [f64; MAX_INPUTS],
    /// Step of the last message.
    heard: u64,
}

/// Manual control that can be taken over and given back.
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

    /// Takes over (1) or gives back (0); anybody may give back. Until the first message the last command is
    /// held.
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

    /// Receives stick messages. A message beyond a limit is ignored as a whole and counted as refused. After
    /// too long a silence manual control ends, and the change is returned to be published.
    pub(super) fn take(&mut self, step: u64, refused: &mut u64) -> Result<Option<Adjustment>, NodeError> {
        // At most the queue's length: a sender without a pause must not delay the step.
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

    /// Manual inputs, while in control.
    pub(super) fn u(&self) -> Option<&[f64; MAX_INPUTS]> {
        self.held.as_ref().map(|held| &held.u)
    }

    /// Ends manual control at the beginning of a new run.
    pub(super) fn forget(&mut self) {
        self.held = None;
    }
}
