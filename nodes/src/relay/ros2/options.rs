//! Options of the relay to ROS 2.

use std::time::Duration;

use super::names::RosNode;
use crate::config::Mode;

/// Options of the relay: its bench, and the ROS 2 network that it joins.
#[derive(Debug, Clone)]
pub struct Ros2Options {
    /// Pace of the loop.
    pub mode: Mode,
    /// Period of the loop.
    pub period: Duration,
    /// True when the relay flies the vehicle; otherwise it only publishes.
    pub controls: bool,
    /// Its node in ROS 2.
    pub node: RosNode,
    /// Zenoh endpoints to connect to.
    pub connect: Vec<String>,
    /// Zenoh endpoints to listen on.
    pub listen: Vec<String>,
}
