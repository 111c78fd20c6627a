//! Flow control: a lockstep plant does not run away from the recorder, nor from the mirror.

use whirlstand_bus::{Bus, Subscriber, Transport};
use whirlstand_msgs::{Message, Progress};

use crate::config::{Mode, NodeConfig, OnFinding, Role};
use crate::error::NodeError;
use crate::mirror::PACE_TOPIC;
use crate::peers::Peers;
use crate::ports::receive;
use crate::recorder::QUEUE_DEPTH;
use crate::succession;

/// Steps that may be on their way to the recorder. Half its queue, because a step's estimate and command can
/// come after the next step's measurement.
const WINDOW: u64 = QUEUE_DEPTH as u64 / 2;

/// The same over a network, where what a recorder that stands still has not read waits in the buffers of its sockets: with
/// less than 1 kB of each sender and step it is less than Linux gives a socket at first (`tcp_wmem`, `tcp_rmem`).
const NETWORK_WINDOW: u64 = 32;

/// All whom a lockstep plant does not run away from.
pub(super) struct Paces(Vec<(Role, Pace)>);

impl Paces {
    pub(super) fn open(bus: &Bus, config: &NodeConfig) -> Result<Self, NodeError> {
        let lockstep = config.mode == Mode::Lockstep;
        let followers = [
            (Role::Recorder, config.recorder.is_some(), Progress::TOPIC),
            (Role::Mirror, config.mirror.is_some(), PACE_TOPIC),
        ];
        let followers = followers.into_iter().filter(|(_, flies, _)| *flies && lockstep);
        let changes_laws = config.mirror.is_some_and(|m| m.on_finding == OnFinding::Law);
        let open = |(role, _, topic)| {
            let mut pace = Pace::open(bus, config.transport, topic)?;
            if role == Role::Mirror && changes_laws {
                pace.window = pace.window.min(succession::WINDOW);
            }
            Ok((role, pace))
        };
        Ok(Self(followers.map(open).collect::<Result<_, NodeError>>()?))
    }

    /// Whether step `step` may be published now: all that live have room for it.
    pub(super) fn may_go_on(&mut self, step: u64, peers: &mut Peers) -> Result<bool, NodeError> {
        let mut may = true;
        for (role, pace) in &mut self.0 {
            if peers.take_replaced(*role) {
                pace.forget();
            }
            may &= pace.may_go_on(step)?;
        }
        Ok(may)
    }
}

/// Keeps count of how far the recorder, or the mirror, has come.
struct Pace {
    progress: Subscriber<Progress>,
    window: u64,
    recorded: u64,
    /// Nobody waits for a recorder that was replaced until the new one says something.
    present: bool,
}

impl Pace {
    /// `topic`: where the follower says how far it has come.
    fn open(bus: &Bus, transport: Transport, topic: &str) -> Result<Self, NodeError> {
        let window = if transport == Transport::Zenoh { NETWORK_WINDOW } else { WINDOW };
        Ok(Self { progress: bus.subscriber_on(topic, QUEUE_DEPTH)?, window, recorded: 0, present: true })
    }

    /// The recorder is another process now; what was on its way to the one before is lost.
    fn forget(&mut self) {
        self.present = false;
    }

    /// Whether step `step` may be published now: a recorder that lives has room for it.
    fn may_go_on(&mut self, step: u64) -> Result<bool, NodeError> {
        // It is not worth looking for news at every step.
        if step.saturating_sub(self.recorded) < self.window / 4 {
            return Ok(true);
        }
        let mut refused = 0;
        while let Some(p) = receive(&mut self.progress, &mut refused)? {
            // A recorder that has written nothing yet has just come; it owes nothing from before.
            self.recorded = if p.written == 0 { step } else { p.head().step };
            self.present = true;
        }
        Ok(!self.present || step.saturating_sub(self.recorded) <= self.window)
    }
}
