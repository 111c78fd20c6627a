//! Ports between processes, whatever the transport.

use crate::{RecvError, SendError};

/// Sends messages of one type to other processes.
pub(crate) trait PublisherPort<M> {
    /// Sends the message with a sequence number.
    fn send(&mut self, topic: &str, message: &M, seq: u64) -> Result<(), SendError>;
    /// True when the topic has a subscriber now.
    fn has_subscribers(&self, topic: &str) -> Result<bool, SendError>;
}

/// Receives messages of one type from other processes.
pub(crate) trait SubscriberPort<M> {
    /// The oldest waiting message.
    fn try_recv(&mut self, topic: &str) -> Result<Option<M>, RecvError>;
    /// Number of messages that will never be received.
    fn lost(&self) -> u64;
}
