//! What the nodes that answer messages have in common, so that one loop runs each of them.

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

    /// Hears the others, and reports when a report is due.
    ///
    /// # Errors
    /// The transport fails.
    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError>;

    /// Whether it still waits to hear its peers.
    fn is_starting(&self) -> bool;

    /// Whether a report is due.
    fn is_due(&self, now: Instant) -> bool;

    /// When to take a turn even if no message comes.
    fn wake_at(&self) -> Instant;

    /// Says good-bye; returns the last report.
    ///
    /// # Errors
    /// The transport fails.
    fn stop(&mut self) -> Result<Health, NodeError>;
}
