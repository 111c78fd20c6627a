//! Runs one node as one process: opens the bus, reports readiness, and runs until its end.

use std::time::{Duration, Instant};

use whirlstand_bridge::autopilot::AutopilotConfig;
use whirlstand_bus::Bus;
use whirlstand_msgs::Health;

use crate::bridge::hil::Hil;
use crate::bridge::vehicle::run_vehicle;
use crate::clock::{Clock, Turn};
use crate::config::{Mode, NodeConfig, Role};
use crate::controller::Controller;
use crate::error::NodeError;
use crate::estimator::Estimator;
use crate::follower::Follower;
use crate::mirror::Mirror;
use crate::notices;
use crate::os::{MonotonicTime, StopFlag, sleep_until};
use crate::plant::Plant;
use crate::ready::get_ready;
use crate::recorder::{POLL_PERIOD, POLL_PERIOD_REALTIME, Recorder};
use crate::setup::Setup;

/// Longest time for which a report waits after an answer: a small part of the time between reports.
const LONGEST_PAUSE: Duration = Duration::from_millis(10);

/// Runs a node until its end: the plant until the last step, the others until `SIGTERM`.
///
/// # Errors
/// [`NodeError`] when the node cannot start or cannot go on.
pub fn run_node(role: Role, config: &NodeConfig) -> Result<(), NodeError> {
    let stop = StopFlag::on_signals()
        .map_err(|source| NodeError::System { action: "install signal handlers", source })?;
    run_node_until(role, config, &stop).map(drop)
}

/// Runs a node as [`run_node`], until `stop` is set; returns the node's last report.
///
/// # Errors
/// As [`run_node`].
pub fn run_node_until(role: Role, config: &NodeConfig, stop: &StopFlag) -> Result<Health, NodeError> {
    let _writing = notices::begin()?;
    if let Some(bridge) = config.bridge.as_ref().filter(|b| role == Role::Plant && b.kind.is_vehicle()) {
        return run_vehicle(config, bridge, stop);
    }
    let setup = Setup::new(config)?;
    let bus = Bus::open(&Setup::bus_config(config, role))?;
    let pause = match config.mode {
        Mode::Lockstep => Duration::ZERO,
        Mode::Realtime => Duration::from_nanos(config.period_ns / 2).min(LONGEST_PAUSE),
    };
    match role {
        Role::Plant => {
            let mut plant = Plant::open(&bus, config, &setup)?;
            get_ready(role, config, &bus, &[])?;
            run_plant(&bus, &mut plant, stop)
        }
        Role::Estimator => {
            let node = Estimator::open(&bus, config, &setup)?;
            get_ready(role, config, &bus, &[])?;
            run_follower(&bus, node, pause, stop)
        }
        Role::Controller => match config.bridge.as_ref().and_then(AutopilotConfig::of) {
            Some(autopilot) => {
                let node = Hil::open(&bus, config, &setup, &autopilot)?;
                get_ready(role, config, &bus, &[])?;
                run_follower(&bus, node, pause, stop)
            }
            None => {
                let node = Controller::open(&bus, config, &setup)?;
                get_ready(role, config, &bus, &[])?;
                run_follower(&bus, node, pause, stop)
            }
        },
        Role::Recorder => {
            let node = Recorder::open(&bus, config, &setup)?;
            get_ready(role, config, &bus, &[])?;
            let pause = match config.mode {
                Mode::Lockstep => POLL_PERIOD,
                Mode::Realtime => POLL_PERIOD_REALTIME,
            };
            run_recorder(node, pause, stop)
        }
        Role::Mirror => {
            let node = Mirror::open(&bus, config, &setup)?;
            get_ready(role, config, &bus, &[])?;
            let pause = match config.mode {
                Mode::Lockstep => POLL_PERIOD,
                Mode::Realtime => POLL_PERIOD_REALTIME,
            };
            run_mirror(node, pause, stop)
        }
    }
}

pub(crate) fn run_plant(bus: &Bus, plant: &mut Plant, stop: &StopFlag) -> Result<Health, NodeError> {
    let mut clock = Clock::exact();
    loop {
        if stop.is_set() {
            plant.stop();
        }
        let turn = if let Some(deadline) = plant.deadline() {
            // The command is awaited only to record its arrival; the step is done at the deadline.
            bus.wait_until(deadline.instant(), || {
                Ok::<_, NodeError>(plant.turn(&mut clock)? == Turn::Worked || stop.is_set())
            })?;
            sleep_until(deadline, || stop.is_set());
            if MonotonicTime::now() >= deadline {
                plant.tick(&mut clock)?;
            }
            Turn::Worked
        } else {
            let mut turn = Turn::Idle;
            bus.wait_until(plant.wake_at(), || {
                turn = plant.turn(&mut clock)?;
                Ok::<_, NodeError>(turn != Turn::Idle || stop.is_set())
            })?;
            turn
        };
        if turn == Turn::Ended {
            return plant.take_divergence().map_or_else(|| Ok(*plant.health()), Err);
        }
    }
}

/// Runs a follower, whose reports are published not earlier than `pause` after an answer, while nobody with whom it may
/// share a CPU is at work. A report that is late by twice as much is published at once.
fn run_follower(
    bus: &Bus,
    mut node: impl Follower,
    pause: Duration,
    stop: &StopFlag,
) -> Result<Health, NodeError> {
    let mut clock = Clock::exact();
    let mut answered = clock.last();
    while !stop.is_set() {
        let wake = node.wake_at();
        let wake = if node.is_due(wake) { wake.max(answered + pause) } else { wake };
        let worked = bus.wait_until(wake, || {
            if node.is_starting() {
                node.housekeeping(Instant::now())?;
            }
            Ok::<_, NodeError>(node.turn(&mut clock)? == Turn::Worked || stop.is_set())
        })?;
        // The answer's own time stamp shows whether a report is due; the clock need not be read again.
        answered = if worked { clock.last() } else { answered };
        let late = answered.checked_sub(2 * pause).is_some_and(|time| node.is_due(time));
        if !worked || node.is_starting() || late {
            node.housekeeping(Instant::now())?;
        }
    }
    node.stop()
}

fn run_mirror(mut node: Mirror, pause: Duration, stop: &StopFlag) -> Result<Health, NodeError> {
    loop {
        if stop.is_set() {
            node.stop();
        }
        if node.turn(Instant::now())? == Turn::Ended {
            return Ok(*node.health());
        }
        let wake = MonotonicTime(MonotonicTime::now().0 + pause.as_nanos() as u64);
        sleep_until(wake, || stop.is_set());
    }
}

fn run_recorder(mut node: Recorder, pause: Duration, stop: &StopFlag) -> Result<Health, NodeError> {
    loop {
        let now = Instant::now();
        if stop.is_set() {
            node.stop(now);
        }
        if node.turn(now)? == Turn::Ended {
            return Ok(*node.health());
        }
        let wake = MonotonicTime(MonotonicTime::now().0 + pause.as_nanos() as u64);
        sleep_until(wake, || stop.is_set());
    }
}
