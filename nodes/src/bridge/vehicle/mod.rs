//! A real vehicle that replaces the plant.
//!
//! There are two threads: this one waits for bytes and deadlines, publishes the measurements and counts the
//! steps, and polls for the answer for a short time; the other waits for commands on the bus and sends later
//! ones to the vehicle. They share the [`SharedVehicle`], whose lock is held for microseconds. A command is
//! sent at once: the period of latency for which the law accounts is spent on the way to the vehicle.
//! Commands that are late, early, repeated or not finite are refused by the same gate as in the simulated
//! plant.

mod bus_receiver;
mod commands;
mod duplicate_filter;
#[cfg(feature = "gamepad")]
mod gamepad;
pub(super) mod links;
mod open;
mod reports;
mod requirements;
pub(super) mod shared_vehicle;

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use whirlstand_bridge::config::{BridgeConfig, BridgeKind, Pace};
use whirlstand_bridge::vehicle::Group;
use whirlstand_bus::{Bus, Publisher};
use whirlstand_msgs::{Head, Health, Imu, NodeState, Odometry, Reported, Sent, charge, flags};

use crate::config::{NodeConfig, Role};
use crate::error::NodeError;
use crate::gate::Gate;
use crate::os::StopFlag;
use crate::peers::Peers;
use crate::ready::get_ready;
use crate::setup::Setup;
use crate::wait_report::WaitReport;
use bus_receiver::BusReceiver;
use commands::Commands;
use duplicate_filter::Reader;
use links::VehicleLinks;
pub use open::open_vehicle;
use reports::{state, tell_figures, tell_strangers};
use shared_vehicle::{SharedVehicle, lock};

/// Longest sleep: a stop request just before the sleep is noticed after it.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Longest busy wait for the command that answers a measurement: a fast controller then costs no wake-up. It
/// is short, because a node of high priority must not starve the controller for which it waits.
const SPIN_TIME: Duration = Duration::from_micros(50);

/// Repetition period of an unanswered step 0.
const REPEAT: Duration = Duration::from_millis(200);

/// Shortest and longest time between two steps with the vehicle's pace, in periods: after the longest a step
/// is made without an attitude.
const SOONEST: f64 = 0.5;
const LATEST: f64 = 1.5;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Waiting for the other nodes and for the vehicle's attitude.
    Joining { until: Instant },
    /// Step 0 is published, its command awaited.
    Answering { until: Instant, repeat: Instant },
    /// In the loop.
    Looping,
    /// The last step is published.
    Ending { until: Instant },
}

/// The bridge as a node.
struct VehicleNode {
    shared: Arc<Mutex<SharedVehicle>>,
    links: VehicleLinks,
    imu: Publisher<Imu>,
    odometry: Option<Publisher<Odometry>>,
    sent: Publisher<Sent>,
    /// Only for a vehicle whose protocol has a mode.
    reported: Option<Publisher<Reported>>,
    peers: Peers,
    phase: Phase,
    pace: Pace,
    period: Duration,
    period_ns: u64,
    steps: u64,
    start_timeout: Duration,
    /// Next step.
    step: u64,
    /// Deadline of that step by the clock.
    due: Instant,
    /// Time of the last step.
    stepped: Instant,
    /// Number of periods in which this node was not running.
    overruns: u64,
    last_imu: Imu,
    commands: Commands,
    receiver: BusReceiver,
    waits: WaitReport,
}

/// Runs the bridge in place of the plant until the last step, or until `stop` is set.
///
/// # Errors
/// [`NodeError`] for invalid options, nodes or a vehicle that do not appear, or a failed transport.
pub fn run_vehicle(config: &NodeConfig, bridge: &BridgeConfig, stop: &StopFlag) -> Result<Health, NodeError> {
    let setup = Setup::new(config)?;
    let vehicle = open_vehicle(config, bridge, &setup)?;
    let gate = Gate::new(setup.limits, config.plant.misses_to_failsafe);
    let links = VehicleLinks::new(bridge)?;
    let shared = Arc::new(Mutex::new(links.share(vehicle, gate, Instant::now())));
    #[cfg(feature = "gamepad")]
    gamepad::listen(bridge, shared.clone())?;
    #[cfg(not(feature = "gamepad"))]
    requirements::refuse_gamepad(bridge)?;
    let commands = Commands::start(config, shared.clone(), stop.clone())?;
    let bus = Bus::open(&Setup::bus_config(config, Role::Plant))?;
    let (imu, sent) = (bus.publisher()?, bus.publisher()?);
    let reported = if bridge.kind == BridgeKind::Mavlink { Some(bus.publisher()?) } else { None };
    let receiver = BusReceiver::open(&bus, Reader::Measurements)?;
    let odometry = if setup.map.has_odometry() { Some(bus.publisher()?) } else { None };
    let peers = Peers::open(&bus, Role::Plant, config.peers.clone())?;
    let now = Instant::now();
    let start_timeout = Duration::from_secs_f64(config.start_timeout_s);
    let mut node = VehicleNode {
        shared,
        links,
        imu,
        odometry,
        sent,
        reported,
        peers,
        phase: Phase::Joining { until: now + start_timeout },
        pace: pace(bridge),
        period: Duration::from_nanos(config.period_ns),
        period_ns: config.period_ns,
        steps: config.steps,
        start_timeout,
        step: 0,
        due: now,
        stepped: now,
        overruns: 0,
        last_imu: whirlstand_msgs::Message::zeroed(),
        commands,
        receiver,
        waits: WaitReport::new(now),
    };
    get_ready(Role::Plant, config, &bus, node.commands.locators())?;
    let result = node.run(stop);
    node.end();
    result?;
    node.peers.set_state(NodeState::Stopping);
    node.report(Instant::now())?;
    Ok(node.peers.report)
}

impl VehicleNode {
    fn run(&mut self, stop: &StopFlag) -> Result<(), NodeError> {
        loop {
            if stop.is_set() {
                return Ok(());
            }
            let fresh = self.links.turn(&self.shared);
            let now = Instant::now();
            match self.phase {
                Phase::Joining { until } => self.join(now, until)?,
                Phase::Answering { until, repeat } => self.await_answer(now, until, repeat)?,
                Phase::Looping => {
                    if self.is_due(now, fresh) {
                        self.advance(now)?;
                        self.await_command()?;
                        if self.step == self.steps {
                            self.phase = Phase::Ending { until: now + self.period * 2 };
                        }
                    }
                }
                Phase::Ending { until } => {
                    if now >= until || lock(&self.shared).gate.is_ready() {
                        return Ok(());
                    }
                }
            }
            self.attend(now)?;
            self.sleep();
        }
    }

    /// Time-dependent work: detects silence, sends heartbeats, notes, health.
    fn attend(&mut self, now: Instant) -> Result<(), NodeError> {
        let mut shared = lock(&self.shared);
        let at = shared.now();
        if at >= shared.vehicle.wake_at(at) {
            shared.vehicle.poll(at);
            shared.flush();
        }
        while let Some(note) = shared.vehicle.note() {
            let step = self.step.saturating_sub(1);
            if note.warn {
                tracing::warn!(step, "{}", note.text);
            } else {
                tracing::info!(step, "{}", note.text);
            }
        }
        let state = state(shared.vehicle.mode());
        let latency = shared.latency.take();
        drop(shared);
        if let Some(latency) = latency {
            self.peers.record_latency(latency);
        }
        if matches!(self.phase, Phase::Answering { .. } | Phase::Looping) {
            self.peers.set_state(state);
        }
        self.commands.check()?;
        if self.peers.is_due(now) { self.report(now) } else { Ok(()) }
    }

    fn join(&mut self, now: Instant, until: Instant) -> Result<(), NodeError> {
        self.peers.turn(now)?;
        let peers_run = self.peers.not_running().next().is_none();
        let (flies, state) = {
            let vehicle = &lock(&self.shared).vehicle;
            (vehicle.telemetry().values(Group::Attitude).is_some(), state(vehicle.mode()))
        };
        if peers_run && flies {
            self.peers.set_state(state);
            self.phase = Phase::Answering { until: now + self.start_timeout, repeat: now + REPEAT };
            return self.advance(now);
        }
        if now < until {
            let (peers, links) = (&self.peers, &self.links);
            self.waits.tell(now, || if peers_run { links.awaited() } else { peers.missing(now) });
            return Ok(());
        }
        let waited_s = self.start_timeout.as_secs_f64();
        if !peers_run {
            return Err(NodeError::PeersAbsent { missing: self.peers.holding_up(now), waited_s });
        }
        Err(NodeError::no_vehicle(waited_s, &lock(&self.shared).vehicle.figures()))
    }

    fn await_answer(&mut self, now: Instant, until: Instant, repeat: Instant) -> Result<(), NodeError> {
        let (ready, rejected) = {
            let shared = lock(&self.shared);
            (shared.gate.is_ready(), shared.gate.rejected())
        };
        if ready {
            self.phase = if self.step == self.steps { Phase::Ending { until: now } } else { Phase::Looping };
            self.due = now + self.period;
            self.waits.over();
            return Ok(());
        }
        if now >= until {
            return Err(NodeError::NoAnswer { waited_s: self.start_timeout.as_secs_f64(), rejected });
        }
        self.waits.tell(now, || "the first command".into());
        if now >= repeat {
            self.imu.send_again(&self.last_imu)?;
            self.phase = Phase::Answering { until, repeat: now + REPEAT };
        }
        Ok(())
    }

    fn is_due(&self, now: Instant, fresh: bool) -> bool {
        match self.pace {
            Pace::Clock => now >= self.due,
            Pace::Telemetry => {
                let since = now.saturating_duration_since(self.stepped);
                let waits = fresh || lock(&self.shared).vehicle.has_attitude();
                since >= self.period.mul_f64(LATEST) || (waits && since >= self.period.mul_f64(SOONEST))
            }
        }
    }

    /// Performs step `self.step`.
    fn advance(&mut self, now: Instant) -> Result<(), NodeError> {
        let head = Head { seq: 0, step: self.step, stamp_ns: self.step * self.period_ns };
        let (imu, odometry, sent, reported) = {
            let mut shared = lock(&self.shared);
            if self.step > 0 {
                shared.gate.close(false);
            }
            let (mut imu, mut odometry) = shared.vehicle.measure();
            (imu.head, odometry.head) = (head, head);
            let now = shared.now();
            let (mut sent, mut reported) = (shared.vehicle.sent(now), shared.vehicle.reported(now));
            (sent.head, reported.head) = (head, head);
            imu.flags = match sent.in_charge {
                charge::PILOT => flags::MANUAL,
                charge::FAILSAFE => flags::FAILSAFE,
                _ => 0,
            };
            shared.awaited = Some(self.step);
            shared.published = Instant::now();
            (imu, odometry, sent, reported)
        };
        self.sent.send(&sent)?;
        if let Some(publisher) = &mut self.odometry {
            publisher.send(&odometry)?;
        }
        self.imu.send(&imu)?;
        if let Some(publisher) = &mut self.reported {
            publisher.send(&reported)?;
        }
        self.last_imu = imu;
        self.step += 1;
        self.stepped = now;
        // A node that was stopped does not catch up: missed periods count as misses.
        let late = now.saturating_duration_since(self.due).as_nanos() / u128::from(self.period_ns);
        let late = if self.pace == Pace::Clock { u32::try_from(late).unwrap_or(u32::MAX) } else { 0 };
        self.overruns += u64::from(late);
        self.due += self.period * (late + 1);
        Ok(())
    }

    /// Polls for the command that answers the step just published.
    fn await_command(&mut self) -> Result<(), NodeError> {
        let until = Instant::now() + SPIN_TIME.min(self.period / 20);
        loop {
            self.receiver.receive_all(&self.shared, self.commands.counts())?;
            if lock(&self.shared).gate.is_ready() || Instant::now() >= until {
                return Ok(());
            }
            std::hint::spin_loop();
        }
    }

    /// Waits for bytes, or until something is due.
    fn sleep(&self) {
        let now = Instant::now();
        let mut until = now + LONGEST_SLEEP;
        let waits = {
            let shared = lock(&self.shared);
            let at = shared.now();
            until = until.min(now + shared.vehicle.wake_at(at).saturating_sub(at));
            shared.vehicle.has_attitude()
        };
        until = until.min(self.peers.due());
        if self.phase == Phase::Looping {
            until = until.min(match self.pace {
                Pace::Clock => self.due,
                Pace::Telemetry => self.stepped + self.period.mul_f64(if waits { SOONEST } else { LATEST }),
            });
        }
        self.links.wait(until.saturating_duration_since(now));
    }

    fn report(&mut self, now: Instant) -> Result<(), NodeError> {
        let (misses, rejected, figures, dropped) = {
            let mut shared = lock(&self.shared);
            let figures = shared.vehicle.figures();
            (shared.gate.misses(), shared.gate.rejected(), figures, shared.dropped())
        };
        let report = &mut self.peers.report;
        report.head.step = self.step.saturating_sub(1);
        report.steps = self.step;
        report.deadline_misses = misses + self.overruns;
        report.lost = figures.lost.saturating_add(self.commands.lost());
        report.rejected = rejected
            + figures.dropped
            + figures.refused
            + self.links.refused()
            + self.commands.refused()
            + dropped;
        self.peers.turn(now)
    }

    /// Ends with the vehicle at neutral.
    fn end(&mut self) {
        let mut shared = lock(&self.shared);
        let now = shared.now();
        shared.vehicle.end(now);
        shared.flush();
        tell_figures(&shared.vehicle.figures(), shared.dropped());
        tell_strangers(self.links.refused());
    }
}

fn pace(bridge: &BridgeConfig) -> Pace {
    let options = &bridge.options;
    let asked = match bridge.kind {
        BridgeKind::Crsf => options.crsf.as_ref().map(|own| own.pace),
        _ => options.mavlink.as_ref().map(|own| own.pace),
    };
    asked.unwrap_or_default()
}
