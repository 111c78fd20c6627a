//! Health of the nodes of a bench: publishes this node's `Health` and receives that of the others.
//!
//! The handshake before step 0 relies on one rule: a node opens its `Health` subscription last. Having
//! received the health of X therefore means that X has all subscriptions of this node, so that nothing X
//! publishes from now on is lost. A node that has heard from all its peers reports `Running`; the plant
//! starts when all report it.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use whirlstand_bus::{Bus, Publisher, RecvError, Subscriber};
use whirlstand_msgs::{Health, Message, NodeState, latency_bucket};

use crate::config::Role;
use crate::error::NodeError;

/// Wall-clock time between two reports of a node.
pub const HEALTH_PERIOD: Duration = Duration::from_millis(100);

/// Silence after which a peer has stopped, or gets no processor time.
const SILENCE: Duration = HEALTH_PERIOD.saturating_mul(5);

/// Queue length for health: four nodes report ten times per second, and more often while the bench starts.
const HEALTH_DEPTH: usize = 64;

/// The newest health message of a peer.
#[derive(Debug, Clone, Copy)]
pub struct PeerHealth {
    /// State that the peer reported.
    pub state: Option<NodeState>,
    /// Last step that the peer did.
    pub step: u64,
    pid: u32,
    heard: Instant,
}

impl PeerHealth {
    /// True when the peer has been silent for so long that it must have stopped.
    pub fn is_silent(&self, now: Instant) -> bool {
        now >= self.heard + SILENCE
    }
}

/// Publishes and receives `Health`.
pub struct Peers {
    role: Role,
    publisher: Publisher<Health>,
    subscriber: Subscriber<Health>,
    reports: [Option<PeerHealth>; Role::ALL.len()],
    /// Roles whose process was replaced, until queried.
    replaced: [bool; Role::ALL.len()],
    listens_to: Vec<Role>,
    due: Instant,
    settles: NodeState,
    /// Next report; the owner updates its counters before each report.
    pub report: Health,
}

impl Peers {
    /// Opens the topic `health`; to be called after all other ports are open.
    ///
    /// # Errors
    /// The ports cannot be opened.
    pub fn open(bus: &Bus, role: Role, listens_to: Vec<Role>) -> Result<Self, NodeError> {
        let publisher = bus.publisher_as(role.name())?;
        let subscriber = bus.subscriber(HEALTH_DEPTH)?;
        let mut report = Health { pid: std::process::id(), ..Health::zeroed() };
        report.set_node_name(role.name());
        Ok(Self {
            role,
            publisher,
            subscriber,
            reports: [None; Role::ALL.len()],
            replaced: [false; Role::ALL.len()],
            listens_to,
            due: Instant::now(),
            settles: NodeState::Running,
            report,
        })
    }

    /// These peers, of a node that is not in charge when it has heard from all of them: another arms what it speaks for.
    #[must_use]
    pub fn begin_disarmed(self) -> Self {
        Self { settles: NodeState::Disarmed, ..self }
    }

    /// Time of the next report.
    pub fn due(&self) -> Instant {
        self.due
    }

    /// True when a report is due.
    pub fn is_due(&self, now: Instant) -> bool {
        now >= self.due
    }

    /// Receives waiting reports, and publishes one when it is due or a new peer has appeared.
    ///
    /// # Errors
    /// The transport fails.
    pub fn turn(&mut self, now: Instant) -> Result<(), NodeError> {
        while let Some(health) = self.receive()? {
            self.update(&health);
        }
        self.settle();
        if self.is_due(now) { self.publish(now) } else { Ok(()) }
    }

    /// The next report of a peer, for the recorder, which writes them all; `turn` receives them without
    /// returning them.
    ///
    /// # Errors
    /// The transport fails.
    pub fn receive(&mut self) -> Result<Option<Health>, NodeError> {
        match self.subscriber.try_recv() {
            Ok(health) => Ok(health),
            Err(RecvError::Refused { .. }) => {
                self.report.rejected += 1;
                Ok(None)
            }
            Err(e) => Err(e.into()),
        }
    }

    /// Processes a peer's report.
    pub fn update(&mut self, health: &Health) {
        let Some(role) = Role::ALL.into_iter().find(|r| r.name() == health.node_name()) else { return };
        if role == self.role {
            return;
        }
        let report = &mut self.reports[role as usize];
        if report.is_none_or(|h| h.pid != health.pid) {
            self.replaced[role as usize] = report.is_some();
            // A new peer waits for this node's report.
            self.due = Instant::now();
        }
        *report = Some(PeerHealth {
            state: NodeState::from_u32(health.state),
            step: health.head.step,
            pid: health.pid,
            heard: Instant::now(),
        });
    }

    /// Leaves `Starting` once all peers were heard from. The plant decides for itself.
    fn settle(&mut self) {
        if self.is_starting() && self.role != Role::Plant && self.all_reported() {
            self.set_state(self.settles);
        }
    }

    /// True when a peer of this node was not heard from yet.
    pub fn is_starting(&self) -> bool {
        self.report.state == NodeState::Starting as u32
    }

    /// Sets the state, and reports a change at once.
    pub fn set_state(&mut self, state: NodeState) {
        if self.report.state != state as u32 {
            self.report.state = state as u32;
            self.due = Instant::now();
        }
    }

    /// Adds an answer's latency to the histogram.
    pub fn record_latency(&mut self, latency: Duration) {
        let ns = u64::try_from(latency.as_nanos()).unwrap_or(u64::MAX);
        self.report.latency[latency_bucket(ns)] += 1;
        self.report.latency_max_ns = self.report.latency_max_ns.max(ns);
    }

    /// Publishes the report now.
    ///
    /// # Errors
    /// The transport fails.
    pub fn publish(&mut self, now: Instant) -> Result<(), NodeError> {
        self.due = now + HEALTH_PERIOD;
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.report.head.stamp_ns = u64::try_from(unix.as_nanos()).unwrap_or(u64::MAX);
        Ok(self.publisher.send(&self.report)?)
    }

    /// The newest health message of a peer.
    pub fn health(&self, role: Role) -> Option<PeerHealth> {
        self.reports[role as usize]
    }

    /// True when a role was taken over by another, running process since the last call: requests to the
    /// previous one will not be answered.
    pub fn take_replaced(&mut self, role: Role) -> bool {
        self.replaced[role as usize] && self.runs(role) && std::mem::take(&mut self.replaced[role as usize])
    }

    fn runs(&self, role: Role) -> bool {
        let state = self.health(role).and_then(|peer| peer.state);
        use NodeState::{Disarmed, Failsafe, Manual, Running};
        matches!(state, Some(Running | Failsafe | Disarmed | Manual))
    }

    /// Peers of this node that are not yet `Running`.
    pub fn not_running(&self) -> impl Iterator<Item = Role> + '_ {
        self.listens_to.iter().copied().filter(|&r| !self.runs(r))
    }

    /// Peers that hold up the start: those never heard from or silent since, and where there are none, those
    /// not yet `Running`. A peer that speaks and does not run may itself be waiting for one of the former.
    pub fn holding_up(&self, now: Instant) -> Vec<Role> {
        let silent = |&role: &Role| self.health(role).is_none_or(|peer| peer.is_silent(now));
        let silent: Vec<Role> = self.listens_to.iter().copied().filter(silent).collect();
        if silent.is_empty() { self.not_running().collect() } else { silent }
    }

    /// Peers that hold up the start, as text.
    pub fn missing(&self, now: Instant) -> String {
        let missing: Vec<_> = self.holding_up(now).into_iter().map(Role::name).collect();
        format!("the {}", missing.join(" and the "))
    }

    fn all_reported(&self) -> bool {
        self.listens_to.iter().all(|&r| self.health(r).is_some())
    }
}

#[cfg(test)]
mod tests {
    use whirlstand_bus::{BusConfig, Transport};

    use super::*;

    /// Whoever counts the steps of a bench by these reports takes the first one at its word.
    #[test]
    fn the_first_report_of_a_bridge_is_not_that_it_is_in_charge() {
        let bus = Bus::open(&BusConfig::new("first-report", "controller", Transport::Inproc)).unwrap();
        let first = |mut peers: Peers| {
            peers.turn(Instant::now()).unwrap();
            NodeState::from_u32(peers.report.state)
        };
        let peers = || Peers::open(&bus, Role::Controller, vec![]).unwrap();
        assert_eq!(first(peers()), Some(NodeState::Running));
        assert_eq!(first(peers().begin_disarmed()), Some(NodeState::Disarmed));
    }

    /// A recorder that waits for a stopped estimator speaks and does not run: the estimator is the cause.
    #[test]
    fn who_holds_up_the_start_is_who_is_silent_not_who_waits_for_it() {
        let bus = Bus::open(&BusConfig::new("held-up", "plant", Transport::Inproc)).unwrap();
        let mut plant = Peers::open(&bus, Role::Plant, vec![Role::Estimator, Role::Recorder]).unwrap();
        let heard = |role: Role, state: NodeState| {
            let mut health = Health { pid: 1, state: state as u32, ..Health::zeroed() };
            health.set_node_name(role.name());
            health
        };
        assert_eq!(plant.missing(Instant::now()), "the estimator and the recorder");
        plant.update(&heard(Role::Recorder, NodeState::Starting));
        assert_eq!(plant.missing(Instant::now()), "the estimator");
        plant.update(&heard(Role::Estimator, NodeState::Running));
        assert_eq!(plant.missing(Instant::now()), "the recorder");
        let later = Instant::now() + SILENCE;
        plant.update(&heard(Role::Recorder, NodeState::Starting));
        plant.reports[Role::Recorder as usize].as_mut().unwrap().heard = later;
        assert_eq!(plant.missing(later), "the estimator");
    }
}
