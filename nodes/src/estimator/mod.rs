//! The estimator: estimates states from measurements.
//!
//! For `Imu` j the filter predicts with the inputs that were in force over `[t_j-1, t_j)`, which is command
//! j-2 under the plant's own rule ([`Gate`]), and then uses the fresh measurements. A measurement waits for
//! companion messages that are still on their way over another link (the command, or `Odometry` and `Outputs`
//! of the same step): in realtime for a bounded time, in lockstep until they arrive, or until the plant has
//! reported with a measurement that it missed the command as well.
//!
//! It can join at any step: the first received measurement starts the filter. A step number that goes back
//! means that the plant was restarted, and restarts the filter; a repeated step is answered with the same
//! estimate again.

mod filter;
mod history;

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Publisher, Subscriber};
use whirlstand_msgs::{Command, Estimate, Health, Imu, MAX_INPUTS, NodeState, Odometry, Outputs, flags};

use crate::clock::{Clock, Turn};
use crate::companion::Companion;
use crate::config::{Mode, NodeConfig, Role};
use crate::error::NodeError;
use crate::follower::Follower;
use crate::gate::Gate;
use crate::notices::{Notice, say};
use crate::peers::Peers;
use crate::ports::receive;
use crate::setup::Setup;
use crate::signals::Measurement;
pub(crate) use filter::Filter;
pub use filter::filter_of;
use history::{History, LONGEST_GAP};

/// Queue length for measurements and commands.
const DEPTH: usize = 64;

/// Longest wait in lockstep for the command of a foreign program, whose health is unknown.
const FOREIGN_COMMAND: Duration = Duration::from_secs(2);

/// The estimator as a state machine.
pub struct Estimator {
    imus: Subscriber<Imu>,
    odometry: Companion<Odometry>,
    outputs: Companion<Outputs>,
    commands: Subscriber<Command>,
    estimates: Publisher<Estimate>,
    peers: Peers,
    filter: Filter,
    history: History,
    gate: Gate,
    new_gate: Gate,
    lockstep: bool,
    /// Step offset: measurement j needs command j minus this.
    lag: u64,
    /// Longest wait for companion messages of a measurement; none in lockstep, where they arrive as long as
    /// their sender is alive.
    companions: Option<Duration>,
    /// True when the sender of the awaited message has been replaced by another process.
    orphaned: bool,
    /// Flags of the last answered measurement.
    imu_flags: u32,
    pending: Option<(Imu, Instant)>,
    last: Option<Estimate>,
    steps: u64,
    refused: u64,
}

impl Estimator {
    /// Designs the filter and opens the ports.
    ///
    /// # Errors
    /// [`NodeError`] for a vehicle whose states cannot be estimated, or ports that cannot be opened.
    pub fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let filter = Filter::new(config, setup)?;
        let gate = Gate::new(setup.limits, config.plant.misses_to_failsafe);
        let listens_to = [Role::Plant, Role::Controller]
            .into_iter()
            .filter(|&r| r == Role::Plant || config.peers.contains(&r))
            .collect();
        Ok(Self {
            imus: bus.subscriber(DEPTH)?,
            odometry: Companion::open(bus, setup.map.has_odometry(), DEPTH)?,
            outputs: Companion::open(bus, setup.map.has_outputs(), DEPTH)?,
            commands: bus.subscriber(DEPTH)?,
            estimates: bus.publisher()?,
            peers: Peers::open(bus, Role::Estimator, listens_to)?,
            lag: if filter.has_feedthrough() { 1 } else { 2 },
            filter,
            history: History::new(setup.limits.count),
            new_gate: gate.clone(),
            gate,
            lockstep: config.mode == Mode::Lockstep,
            companions: match config.mode {
                Mode::Lockstep if config.peers.contains(&Role::Controller) => None,
                Mode::Lockstep => Some(FOREIGN_COMMAND),
                Mode::Realtime => Some(Duration::from_nanos(config.period_ns / 4)),
            },
            orphaned: false,
            imu_flags: 0,
            pending: None,
            last: None,
            steps: 0,
            refused: 0,
        })
    }

    fn take_commands(&mut self) -> Result<(), NodeError> {
        while let Some(command) = receive(&mut self.commands, &mut self.refused)? {
            self.history.put(&command);
        }
        Ok(())
    }

    fn is_complete(&self, imu: &Imu) -> bool {
        let step = imu.head.step;
        let follows = self.last.as_ref().is_some_and(|l| l.head.step + 1 == step);
        // After a miss no commands arrive, and waiting for each would make the next answers late as well.
        let command = !follows
            || self.is_missed(imu)
            || step.checked_sub(self.lag).is_none_or(|needed| self.history.get(needed).is_some());
        command && self.odometry.has_reached(step) && self.outputs.has_reached(step)
    }

    /// True when no command will arrive for the step that `imu` needs. In lockstep the plant has reported it
    /// with the measurement at which that command would have come into force.
    fn is_missed(&self, imu: &Imu) -> bool {
        let flags = match (self.lockstep, self.lag) {
            (true, 1) => imu.flags,
            (true, _) => self.imu_flags,
            (false, _) => self.gate.applied().flags,
        };
        flags & flags::HELD != 0
    }

    fn answer(&mut self, imu: &Imu) -> Result<(), NodeError> {
        let step = imu.head.step;
        let steps_to_predict = match &self.last {
            Some(last) if step == last.head.step => return Ok(self.estimates.send_again(last)?),
            Some(last) if step < last.head.step => {
                say(Notice::NewRun { step, then: "restarting the filter" });
                self.restart();
                0
            }
            Some(last) if step - last.head.step > LONGEST_GAP => {
                say(Notice::Gap { step, last: last.head.step });
                self.restart();
                0
            }
            Some(last) => step - last.head.step,
            None => 0,
        };
        for i in step + 1 - steps_to_predict..=step {
            self.follow(i);
            if i < step {
                self.filter.predict(&self.gate.applied().u);
            }
        }
        let u_before = self.gate.applied().u;
        let u_now = if self.filter.has_feedthrough() { self.u_now(step) } else { u_before };
        let measurement =
            Measurement { imu: *imu, odometry: self.odometry.at(step), outputs: self.outputs.at(step) };
        let clean = self.filter.step(&measurement, &u_before, &u_now);
        self.refused += u64::from(!clean);
        let estimate = self.last.insert(self.filter.estimate(imu.head));
        self.estimates.send(estimate)?;
        self.steps += 1;
        Ok(())
    }

    /// Advances the gate to the inputs in force over `[t_i-1, t_i)`, which is command i-2.
    fn follow(&mut self, i: u64) {
        if let Some(awaited) = i.checked_sub(2) {
            if let Some(command) = self.history.get(awaited) {
                // The plant counts faults; here only the outcome matters.
                let _ = self.gate.offer(command, awaited);
            }
            self.gate.close(self.lockstep);
        }
    }

    /// Inputs acting at measurement `step`: command `step` - 1, which the plant had before it measured.
    fn u_now(&self, step: u64) -> [f64; MAX_INPUTS] {
        let mut ahead = self.gate.clone();
        if let Some(awaited) = step.checked_sub(1) {
            if let Some(command) = self.history.get(awaited) {
                let _ = ahead.offer(command, awaited);
            }
            ahead.close(self.lockstep);
        }
        ahead.applied().u
    }

    fn restart(&mut self) {
        self.filter.restart();
        self.gate = self.new_gate.clone();
        self.history.clear();
        self.last = None;
    }

    fn count(&mut self) {
        let report = &mut self.peers.report;
        report.head.step = self.last.map_or(0, |l| l.head.step);
        report.steps = self.steps;
        report.deadline_misses = 0;
        report.lost = [self.commands.lost(), self.odometry.lost(), self.outputs.lost()]
            .into_iter()
            .fold(self.imus.lost(), u64::saturating_add);
        report.rejected = self.refused;
    }
}

impl Follower for Estimator {
    fn turn(&mut self, clock: &mut Clock) -> Result<Turn, NodeError> {
        let (imu, since) = match self.pending.take() {
            Some(pending) => pending,
            None => match receive(&mut self.imus, &mut self.refused)? {
                Some(imu) => (imu, clock.now()),
                None => {
                    // Between two measurements there is time for the inputs of the next one.
                    if self.last.as_ref().is_some_and(|l| self.history.get(l.head.step).is_none()) {
                        self.take_commands()?;
                    }
                    return Ok(Turn::Idle);
                }
            },
        };
        self.odometry.take(imu.head.step, &mut self.refused)?;
        self.outputs.take(imu.head.step, &mut self.refused)?;
        if !self.is_complete(&imu) {
            self.take_commands()?;
            let waited = clock.now().saturating_duration_since(since);
            let patient = !self.orphaned && self.companions.is_none_or(|longest| waited < longest);
            if patient && !self.is_complete(&imu) {
                self.pending = Some((imu, since));
                return Ok(Turn::Idle);
            }
        }
        self.answer(&imu)?;
        self.imu_flags = imu.flags;
        self.orphaned = false;
        if clock.is_exact() {
            self.peers.record_latency(clock.now().saturating_duration_since(since));
        }
        Ok(Turn::Worked)
    }

    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError> {
        self.count();
        self.peers.turn(now)?;
        let replaced = [Role::Plant, Role::Controller].map(|role| self.peers.take_replaced(role));
        self.orphaned |= self.pending.is_some() && replaced.contains(&true);
        Ok(())
    }

    fn wake_at(&self) -> Instant {
        let due = self.peers.due();
        match (self.pending, self.companions) {
            (Some((_, since)), Some(longest)) => due.min(since + longest),
            _ => due,
        }
    }

    fn is_due(&self, now: Instant) -> bool {
        self.peers.is_due(now)
    }

    fn is_starting(&self) -> bool {
        self.peers.is_starting()
    }

    fn stop(&mut self) -> Result<Health, NodeError> {
        self.count();
        self.peers.set_state(NodeState::Stopping);
        self.peers.publish(Instant::now())?;
        Ok(self.peers.report)
    }
}
