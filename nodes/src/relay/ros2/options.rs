//! What the relay to ROS 2 must be told.

use std::time::Duration;

use super::names::RosNode;
use crate::config::Mode;

/// What the relay must know of its bench, and of the ROS 2 that it joins.
#[derive(Debug, Clone)]
pub struct Ros2Options {
    /// What sets the pace of the loop.
    pub mode: Mode,
    /// Period of the loop.
    pub period: Duration,
    /// The relay flies the vehicle; otherwise it only publishes.
    pub controls: bool,
    /// The node that it is in ROS 2.
    pub node: RosNode,
    /// Zenoh endpoints that it connects to.
    pub connect: Vec<String>,
    /// Zenoh endpoints that it listens on.
    pub listen: Vec<String>,
}
