//! The relay's ROS 2 session: declarations, published messages, and received commands.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use serde_json::json;
use whirlstand_bus::{WaitStrategy, open_session};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;

use super::messages::{Float64MultiArray, Imu, Odometry, RosType, TfMessage, decode, encode};
use super::names::{Entity, attachment, gid};
use super::options::Ros2Options;
use crate::config::Mode;
use crate::error::NodeError;

/// Largest number of waiting commands; further ones are dropped, as they would be too late anyway.
const WAITING: usize = 64;

/// A publisher of one topic.
struct Topic {
    port: zenoh::pubsub::Publisher<'static>,
    gid: [u8; 16],
    number: i64,
    _token: LivelinessToken,
}

/// The relay's ROS 2 session.
pub(super) struct Ros {
    imu: Topic,
    odometry: Topic,
    tf: Topic,
    pub(super) commands: Receiver<Vec<f64>>,
    _commands: Option<(zenoh::pubsub::Subscriber<()>, LivelinessToken)>,
    _node: LivelinessToken,
    _session: zenoh::Session,
}

fn failed(action: &'static str, error: impl std::fmt::Display) -> NodeError {
    NodeError::System { action, source: std::io::Error::other(error.to_string()) }
}

/// Settings as for `rmw_zenoh` sessions: a peer that finds others through the router to which it
/// connects.
fn settings(options: &Ros2Options) -> serde_json::Value {
    // As on the bus: in lockstep no message is lost to a temporarily slow peer, in real time no sender waits.
    let congestion = match options.mode {
        Mode::Lockstep => WaitStrategy::lockstep(),
        Mode::Realtime => WaitStrategy::realtime(),
    }
    .congestion;
    json!({
        "mode": "peer",
        "connect": { "endpoints": options.connect, "timeout_ms": -1, "exit_on_failure": false },
        "listen": { "endpoints": options.listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": true } },
        "timestamping": { "enabled": true },
        "transport": { "link": { "tx": { "queue": { "congestion_control": {
            "drop": { "wait_before_drop": congestion.as_micros() as u64 },
        } } } } },
    })
}

impl Ros {
    pub(super) fn open(options: &Ros2Options) -> Result<Self, NodeError> {
        let session =
            open_session(&settings(options)).map_err(|e| failed("open a Zenoh session with ROS 2", e))?;
        let node = declare(&session, options.node.token(&session.zid().to_string()))?;
        let (sender, commands) = sync_channel(WAITING);
        let received = options.controls.then(|| subscribe(&session, options, sender)).transpose()?;
        Ok(Self {
            imu: topic::<Imu>(&session, options, 1, "imu")?,
            odometry: topic::<Odometry>(&session, options, 2, "odom")?,
            tf: topic::<TfMessage>(&session, options, 3, "/tf")?,
            commands,
            _commands: received,
            _node: node,
            _session: session,
        })
    }

    pub(super) fn publish(&mut self, imu: &Imu, odometry: &Odometry, tf: &TfMessage) {
        // The message that a controller answers is sent last, so that it has the whole step by then.
        self.tf.put(tf);
        self.odometry.put(odometry);
        self.imu.put(imu);
    }
}

fn declare(session: &zenoh::Session, key: String) -> Result<LivelinessToken, NodeError> {
    session.liveliness().declare_token(key).wait().map_err(|e| failed("tell ROS 2 of the relay", e))
}

fn topic<T: RosType>(
    session: &zenoh::Session,
    options: &Ros2Options,
    id: usize,
    name: &str,
) -> Result<Topic, NodeError> {
    let name = options.node.topic(name);
    let port = session
        .declare_publisher(options.node.key::<T>(&name))
        .congestion_control(CongestionControl::Drop)
        .express(true)
        .wait()
        .map_err(|e| failed("publish for ROS 2", e))?;
    let token = options.node.token_of::<T>(&session.zid().to_string(), id, Entity::Publisher, &name);
    Ok(Topic { port, gid: gid(&token), number: 0, _token: declare(session, token)? })
}

fn subscribe(
    session: &zenoh::Session,
    options: &Ros2Options,
    sender: SyncSender<Vec<f64>>,
) -> Result<(zenoh::pubsub::Subscriber<()>, LivelinessToken), NodeError> {
    let name = options.node.topic("command");
    let told = std::sync::atomic::AtomicBool::new(false);
    let port = session
        .declare_subscriber(options.node.key::<Float64MultiArray>(&name))
        .callback(move |sample| match decode(&sample.payload().to_bytes()) {
            // A full queue is not read any more: the bench has ended.
            Ok(values) => drop(sender.try_send(values)),
            Err(why) if !told.swap(true, std::sync::atomic::Ordering::Relaxed) => {
                tracing::warn!("a command of ROS 2 cannot be used: {why}");
            }
            Err(_) => {}
        })
        .wait()
        .map_err(|e| failed("subscribe to commands of ROS 2", e))?;
    let zid = session.zid().to_string();
    let token = options.node.token_of::<Float64MultiArray>(&zid, 4, Entity::Subscription, &name);
    Ok((port, declare(session, token)?))
}

impl Topic {
    /// A closed or slow link is handled by Zenoh: messages are dropped, and the next one is tried.
    fn put(&mut self, message: &impl Serialize) {
        let Some(bytes) = encode(message) else { return };
        self.number += 1;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos() as i64);
        let sent = self.port.put(bytes).attachment(attachment(self.number, now, self.gid)).wait();
        if let Err(e) = sent {
            tracing::debug!("a message for ROS 2 was not sent: {e}");
        }
    }
}
