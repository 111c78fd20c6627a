//! Relay to a controller in ROS 2: the vehicle's state is published for it, and its commands fly the vehicle.
//!
//! The relay speaks Zenoh as `rmw_zenoh` does, so that the tools of ROS 2 find its topics. A ROS 2 command
//! does not name its step. In lockstep, and always at step 0, the first one that arrives after a step was
//! published answers it. In real time the newest one does, at once when it arrives within [`ANSWER_SHARE`] of
//! the period; after 0.2 s without one there is no answer, and the plant goes to its failsafe.

mod held;
mod messages;
mod names;
mod options;
mod session;

use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Command, Estimate, Head, Imu, Message, Odometry};

use self::held::Held;
use self::messages::{Time, of_step};
pub use self::names::RosNode;
pub use self::options::Ros2Options;
use self::session::Ros;
use super::{Answers, DEPTH};
use crate::config::Mode;
use crate::error::NodeError;
use crate::os::{StopFlag, notify_ready};
use crate::ports::receive;

/// Share of the period for which a controller in real time is waited for; the rest is for transmission of the
/// command.
const ANSWER_SHARE: f64 = 0.5;

/// Period of checks whether the end was requested.
const LOOK: Duration = Duration::from_millis(100);

/// Relays until the end is requested.
///
/// # Errors
/// [`NodeError`] when the bus fails, or no session of Zenoh can be opened.
pub fn run_ros2(bus: &Bus, options: &Ros2Options, stop: &StopFlag) -> Result<(), NodeError> {
    let mut relay = Relay::open(bus, options)?;
    notify_ready(bus.locators()).map_err(|source| NodeError::System {
        action: "tell the launcher that the relay is ready",
        source,
    })?;
    while !stop.is_set() {
        // A step that waits for its answer is repeated only when that was lost.
        let patience = if relay.open_step.is_some() { Duration::ZERO } else { LOOK };
        let mut next = None;
        bus.wait_until(Instant::now() + patience, || {
            next = receive(&mut relay.estimates, &mut relay.damaged)?;
            Ok::<_, NodeError>(next.is_some() || stop.is_set())
        })?;
        if let Some(estimate) = next {
            relay.take(estimate.head)?;
        }
        if let Some(head) = relay.open_step
            && let Some(command) = relay.command(head)
        {
            relay.open_step = None;
            if let Some(answers) = &mut relay.answers {
                answers.send(&command)?;
            }
        }
    }
    Ok(())
}

struct Relay<'a> {
    options: &'a Ros2Options,
    estimates: Subscriber<Estimate>,
    imus: Subscriber<Imu>,
    odometries: Subscriber<Odometry>,
    imu: Imu,
    odometry: Odometry,
    answers: Option<Answers>,
    ros: Ros,
    /// The step without an answer so far.
    open_step: Option<Head>,
    held: Held,
    /// Wall-clock time of step 0, ns since the Unix epoch.
    epoch_ns: Option<u64>,
    damaged: u64,
}

impl<'a> Relay<'a> {
    fn open(bus: &Bus, options: &'a Ros2Options) -> Result<Self, NodeError> {
        Ok(Self {
            options,
            estimates: bus.subscriber(DEPTH)?,
            imus: bus.subscriber(DEPTH)?,
            odometries: bus.subscriber(DEPTH)?,
            imu: Imu::zeroed(),
            odometry: Odometry::zeroed(),
            answers: options.controls.then(|| Answers::open(bus)).transpose()?,
            ros: Ros::open(options)?,
            open_step: None,
            held: Held::default(),
            epoch_ns: None,
            damaged: 0,
        })
    }

    /// Publishes a step, or repeats the answer of one that was answered before.
    fn take(&mut self, head: Head) -> Result<(), NodeError> {
        if let Some(answers) = &mut self.answers
            && let Some(command) = answers.of(head.step)
        {
            return answers.send(&command);
        }
        // The measurements of a step are published before its estimate.
        while let Some(imu) = receive(&mut self.imus, &mut self.damaged)? {
            self.imu = imu;
        }
        while let Some(odometry) = receive(&mut self.odometries, &mut self.damaged)? {
            self.odometry = odometry;
        }
        // Commands that arrived earlier belong to an earlier step.
        while let Ok(command) = self.ros.commands.try_recv() {
            self.held.keep(command, Instant::now());
        }
        let stamp = self.stamp(head);
        let (imu, odometry, tf) = of_step(&self.imu, &self.odometry, stamp);
        self.ros.publish(&imu, &odometry, &tf);
        self.open_step = self.answers.is_some().then_some(head);
        Ok(())
    }

    /// Time stamp of a step in wall-clock time, as the tools of ROS 2 expect it: that of step 0 plus bench
    /// time.
    fn stamp(&mut self, head: Head) -> Time {
        let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos() as u64);
        let epoch_ns = *self.epoch_ns.get_or_insert_with(|| now().saturating_sub(head.stamp_ns));
        Time::from_ns(epoch_ns.saturating_add(head.stamp_ns))
    }

    /// The command for a step; in lockstep, and at step 0, with which the clock starts, none until one
    /// arrives.
    fn command(&mut self, head: Head) -> Option<Command> {
        let realtime = self.options.mode == Mode::Realtime && head.step > 0;
        let window = if realtime { self.options.period.mul_f64(ANSWER_SHARE) } else { LOOK };
        match self.ros.commands.recv_timeout(window) {
            Ok(values) => self.held.keep(values, Instant::now()),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) if realtime => {}
            Err(_) => return None,
        }
        Some(self.held.answer(head, realtime, Instant::now()))
    }
}
