//! Flow control: a lockstep plant waits for the recorder and for the mirror.

use whirlstand_bus::{Bus, Subscriber, Transport};
use whirlstand_msgs::{Message, Progress};

use crate::config::{Mode, NodeConfig, OnFinding, Role};
use crate::error::NodeError;
use crate::mirror::PACE_TOPIC;
use crate::peers::Peers;
use crate::ports::receive;
use crate::recorder::QUEUE_DEPTH;
use crate::succession;

/// Largest number of steps on their way to the recorder. Half its queue, because a step's estimate and
/// command can arrive after the next step's measurement.
const WINDOW: u64 = QUEUE_DEPTH as u64 / 2;

/// Largest number of steps on their way over a network, where unread data of a stopped recorder are in the
/// buffers of its sockets: with less than 1 kB per sender and step it is less than Linux gives a socket
/// initially (`tcp_wmem`, `tcp_rmem`).
const NETWORK_WINDOW: u64 = 32;

/// All nodes for which a lockstep plant waits.
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

    /// True when step `step` may be published now: all live followers have space for it.
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

/// Progress of the recorder or the mirror.
struct Pace {
    progress: Subscriber<Progress>,
    window: u64,
    recorded: u64,
    /// False after a recorder was replaced, until the new one reports.
    present: bool,
}

impl Pace {
    /// Subscribes to `topic`, on which the follower reports its progress.
    fn open(bus: &Bus, transport: Transport, topic: &str) -> Result<Self, NodeError> {
        let window = if transport == Transport::Zenoh { NETWORK_WINDOW } else { WINDOW };
        Ok(Self { progress: bus.subscriber_on(topic, QUEUE_DEPTH)?, window, recorded: 0, present: true })
    }

    /// Resets after the recorder was replaced; messages on their way to the old one are lost.
    fn forget(&mut self) {
        self.present = false;
    }

    /// True when step `step` may be published now: a live recorder has space for it.
    fn may_go_on(&mut self, step: u64) -> Result<bool, NodeError> {
        // Polling at every step would be wasteful.
        if step.saturating_sub(self.recorded) < self.window / 4 {
            return Ok(true);
        }
        let mut refused = 0;
        while let Some(p) = receive(&mut self.progress, &mut refused)? {
            // A recorder that has written nothing yet has just started; it has no backlog.
            self.recorded = if p.written == 0 { step } else { p.head().step };
            self.present = true;
        }
        Ok(!self.present || step.saturating_sub(self.recorded) <= self.window)
    }
}
