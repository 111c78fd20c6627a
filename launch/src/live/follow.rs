//! Follows a topic of a running bench, for any message type.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Carried, MAX_DEPTH, RecvError, Subscriber};
use whirlstand_msgs::{
    Adjustment, Autopilot, Command, Disturbance, Estimate, Finding, Health, Imu, Message, NodeState,
    Odometry, Outputs, Progress, Reported, Sent, Setpoint, Stick, Truth,
};
use whirlstand_nodes::ADJUST_TOPIC;
use whirlstand_nodes::config::Role;
use whirlstand_nodes::controller::PILOT_TOPIC;
use whirlstand_nodes::plant::INJECT_TOPIC;

use super::card::BenchCard;
use super::shown::Shown;
use crate::error::Failure;
use crate::file::unknown;
use crate::keys::OBSERVER;
use crate::supervisor::Signals;

/// Time between two checks for a signal or the end of the bench.
const LOOK: Duration = Duration::from_millis(100);

/// Time without any message after which the bench is joined again: over a network, nodes that were not there yet
/// have addresses by then.
const JOIN_AGAIN: Duration = Duration::from_secs(2);

/// Result of following a topic.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Follow {
    /// Number of messages that were shown.
    pub shown: u64,
    /// Number of messages that were lost because they arrived faster than they were shown.
    pub lost: u64,
    /// The signal that ended it, if one did.
    pub signal: Option<i32>,
}

/// Passes every message of a topic, in a form that can be shown, to `show`, until `show` has enough, a signal
/// arrives, or the bench ends.
///
/// # Errors
/// For a topic that does not exist, a bench that cannot be joined, a signal handler that cannot be installed, or a
/// failure of `show`.
pub(crate) fn follow(
    card: &BenchCard,
    topic: &str,
    mut show: impl FnMut(&Shown<'_>) -> Result<ControlFlow<()>, Failure>,
) -> Result<Follow, Failure> {
    let show = &mut show;
    macro_rules! of {
        ($($name:expr => $message:ident),* $(,)?) => {
            match topic {
                $(name if name == $name => follow_type::<$message>(card, name, show),)*
                other => Err(Failure::Mend(unknown("topic", other, [$($name),*]))),
            }
        };
    }
    of!(
        Imu::TOPIC => Imu,
        Odometry::TOPIC => Odometry,
        Outputs::TOPIC => Outputs,
        Estimate::TOPIC => Estimate,
        Command::TOPIC => Command,
        Setpoint::TOPIC => Setpoint,
        Truth::TOPIC => Truth,
        Sent::TOPIC => Sent,
        Reported::TOPIC => Reported,
        Autopilot::TOPIC => Autopilot,
        Disturbance::TOPIC => Disturbance,
        Finding::TOPIC => Finding,
        Health::TOPIC => Health,
        Progress::TOPIC => Progress,
        Adjustment::TOPIC => Adjustment,
        INJECT_TOPIC => Disturbance,
        PILOT_TOPIC => Setpoint,
        ADJUST_TOPIC => Adjustment,
        Stick::TOPIC => Stick,
    )
}

fn follow_type<M: Carried>(
    card: &BenchCard,
    topic: &str,
    show: &mut impl FnMut(&Shown<'_>) -> Result<ControlFlow<()>, Failure>,
) -> Result<Follow, Failure> {
    let mut signals = Signals::take().map_err(|e| Failure::Run(format!("cannot handle signals: {e}")))?;
    let mut follow = Follow::default();
    while follow.shown == 0 && follow.signal.is_none() && !card.is_over() {
        let bus = card.join(OBSERVER)?;
        let patience = Instant::now() + JOIN_AGAIN;
        if listen::<M>(&bus, card, topic, patience, &mut signals, &mut follow, show)?.is_break() {
            break;
        }
    }
    Ok(follow)
}

/// Receives messages until the end, or until `patience` is over without a message.
fn listen<M: Carried>(
    bus: &Bus,
    card: &BenchCard,
    topic: &str,
    patience: Instant,
    signals: &mut Signals,
    follow: &mut Follow,
    show: &mut impl FnMut(&Shown<'_>) -> Result<ControlFlow<()>, Failure>,
) -> Result<ControlFlow<()>, Failure> {
    let mut messages = bus.subscriber_on::<M>(topic, MAX_DEPTH).map_err(Failure::mend)?;
    let mut end = End::new(bus, card)?;
    loop {
        let mut message = None;
        bus.wait_until(Instant::now() + LOOK, || {
            message = messages.try_recv()?;
            Ok::<_, RecvError>(message.is_some())
        })
        .map_err(Failure::run)?;
        follow.lost = messages.lost();
        follow.signal = signals.next();
        if follow.signal.is_some() {
            return Ok(ControlFlow::Break(()));
        }
        match message {
            Some(message) => {
                follow.shown += 1;
                if show(&Shown::new(topic, &message))?.is_break() {
                    return Ok(ControlFlow::Break(()));
                }
            }
            None if end.has_come(card)? => return Ok(ControlFlow::Break(())),
            None if follow.shown == 0 && Instant::now() >= patience => return Ok(ControlFlow::Continue(())),
            None => {}
        }
    }
}

/// Detects the end of a bench. On this machine its sockets disappear; on another host its plant reports the end.
struct End(Option<Subscriber<Health>>);

impl End {
    fn new(bus: &Bus, card: &BenchCard) -> Result<Self, Failure> {
        let health = card.remote.is_some().then(|| bus.subscriber(MAX_DEPTH)).transpose();
        health.map(Self).map_err(Failure::mend)
    }

    fn has_come(&mut self, card: &BenchCard) -> Result<bool, Failure> {
        let Self(Some(health)) = self else { return Ok(card.is_over()) };
        while let Some(said) = health.try_recv().map_err(Failure::run)? {
            if said.node_name() == Role::Plant.name() && said.state == NodeState::Stopping as u32 {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
