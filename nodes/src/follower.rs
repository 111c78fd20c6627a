//! Common interface of nodes that answer messages, so that one loop runs each of them.

use std::time::Instant;

use whirlstand_msgs::Health;

use crate::clock::{Clock, Turn};
use crate::error::NodeError;

/// A node that answers messages: the estimator and the controller.
pub trait Follower {
    /// Answers the next message, if one waits.
    ///
    /// # Errors
    /// The transport fails.
    fn turn(&mut self, clock: &mut Clock) -> Result<Turn, NodeError>;

    /// Receives the health of the others, and publishes a report when it is due.
    ///
    /// # Errors
    /// The transport fails.
    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError>;

    /// True while it waits for its peers.
    fn is_starting(&self) -> bool;

    /// True when a report is due.
    fn is_due(&self, now: Instant) -> bool;

    /// Time of the next call even if no message arrives.
    fn wake_at(&self) -> Instant;

    /// Announces the end; returns the last report.
    ///
    /// # Errors
    /// The transport fails.
    fn stop(&mut self) -> Result<Health, NodeError>;
}
