//! Options of the relays to controllers that are no programs of a bench.

use std::net::SocketAddr;

use clap::{Args, Subcommand};

#[derive(Debug, Subcommand)]
pub(crate) enum RelayCommand {
    Udp(RelayUdpArgs),
    Ros2(RelayRos2Args),
}

/// Relay to a controller on a UDP port: sends it every Estimate and receives its Commands.
#[derive(Debug, Args)]
#[command(after_help = "In a launch file:\n  \
    [nodes.controller]\n  \
    exec = [\"whirlstand\", \"relay\", \"udp\", \"--peer\", \"127.0.0.1:47801\"]\n\n\
    A datagram contains the schema hash and the message in postcard (docs/wire-format.md); examples/c has a \
    controller.")]
pub(crate) struct RelayUdpArgs {
    /// Where the controller listens; datagrams from elsewhere are ignored.
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub peer: SocketAddr,
    /// Where this relay listens.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:47800")]
    pub listen: SocketAddr,
}

/// Relay to a controller or viewer in ROS 2 with rmw_zenoh: publishes imu, odom and /tf; as the node `controller` it
/// follows command.
#[derive(Debug, Args)]
#[command(
    after_help = "In a launch file, to fly the vehicle from ROS 2 (any other name of the node only publishes):\n  \
    [nodes.controller]\n  \
    exec = [\"whirlstand\", \"relay\", \"ros2\"]\n\n\
    Topics: imu (sensor_msgs/Imu), odom (nav_msgs/Odometry), /tf (tf2_msgs/TFMessage), command (std_msgs/Float64MultiArray: \
    the inputs in the vehicle's order, SI)."
)]
pub(crate) struct RelayRos2Args {
    /// ROS 2 domain [default: ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N")]
    pub domain: Option<u32>,
    /// Namespace of the node and its topics.
    #[arg(long, value_name = "/NAME", default_value = "/")]
    pub namespace: String,
    /// Zenoh endpoint to connect to: the router of rmw_zenoh, or a peer; may be repeated.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
    pub connect: Vec<String>,
    /// Zenoh endpoint to listen on; may be repeated.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:0")]
    pub listen: Vec<String>,
}
