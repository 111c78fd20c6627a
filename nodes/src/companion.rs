//! Messages that belong to a measurement but are published on another topic.

use whirlstand_bus::{Bus, Carried, Subscriber};
use whirlstand_msgs::Message;

use crate::error::NodeError;
use crate::ports::receive;

/// The newest message of a companion topic; where the vehicle has no such topic, a message is always
/// available.
pub(crate) struct Companion<M: Message> {
    subscriber: Option<Subscriber<M>>,
    newest: Option<M>,
}

impl<M: Carried> Companion<M> {
    pub(crate) fn open(bus: &Bus, wanted: bool, depth: usize) -> Result<Self, NodeError> {
        let subscriber = if wanted { Some(bus.subscriber(depth)?) } else { None };
        Ok(Self { subscriber, newest: None })
    }

    /// Receives messages up to a step; those of later steps stay in the queue.
    pub(crate) fn take(&mut self, step: u64, refused: &mut u64) -> Result<(), NodeError> {
        let Some(subscriber) = &mut self.subscriber else { return Ok(()) };
        while self.newest.is_none_or(|m| m.head().step < step) {
            let Some(message) = receive(subscriber, refused)? else { break };
            self.newest = Some(message);
        }
        Ok(())
    }

    /// True when the message of a step has arrived, or will not arrive any more.
    pub(crate) fn has_reached(&self, step: u64) -> bool {
        self.subscriber.is_none() || self.newest.is_some_and(|m| m.head().step >= step)
    }

    /// The message of a step; all zero, and so without a fresh value, when there is none.
    pub(crate) fn at(&self, step: u64) -> M {
        self.newest.filter(|m| m.head().step == step).unwrap_or_else(Message::zeroed)
    }

    pub(crate) fn lost(&self) -> u64 {
        self.subscriber.as_ref().map_or(0, Subscriber::lost)
    }
}
