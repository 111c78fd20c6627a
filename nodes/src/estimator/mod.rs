//! The estimator: measurements in, estimated states out.
//!
//! For `Imu` j the filter predicts with the inputs that were in force over `[t_j-1, t_j)`, which is command j-2
//! under the same rule that the plant obeys ([`Gate`]), and then takes the fresh measurements in. A measurement
//! whose companions are still on their way over another link (the command, or the `Odometry` of the same step)
//! waits for them, for a bounded time.
//!
//! It can join at any step: the first measurement that it hears starts the filter. Steps that go back mean that
//! the plant was restarted, and start it anew; a repeated step is answered with the same estimate again.

mod filter;
mod history;

use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Publisher, Subscriber};
use whirlstand_msgs::{Command, Estimate, Health, Imu, MAX_INPUTS, NodeState, Odometry};

use crate::clock::{Clock, Turn};
use crate::config::{Mode, NodeConfig, Role};
use crate::error::NodeError;
use crate::follower::Follower;
use crate::gate::Gate;
use crate::peers::Peers;
use crate::ports::receive;
use crate::setup::Setup;
use filter::Filter;
pub use filter::filter_of;
use history::{History, LONGEST_GAP};

/// Queue for measurements and commands.
const DEPTH: usize = 64;

/// Longest wait in lockstep for what belongs to a measurement and has not come yet.
const COMPANIONS: Duration = Duration::from_millis(50);

/// The estimator as a state machine.
pub struct Estimator {
    imus: Subscriber<Imu>,
    odometries: Option<Subscriber<Odometry>>,
    commands: Subscriber<Command>,
    estimates: Publisher<Estimate>,
    peers: Peers,
    filter: Filter,
    history: History,
    gate: Gate,
    new_gate: Gate,
    lockstep: bool,
    /// The command that measurement j needs is j minus this.
    lag: u64,
    companions: Duration,
    pending: Option<(Imu, Instant)>,
    odometry: Option<Odometry>,
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
        let odometries = if setup.map.has_odometry() { Some(bus.subscriber(DEPTH)?) } else { None };
        Ok(Self {
            imus: bus.subscriber(DEPTH)?,
            odometries,
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
                Mode::Lockstep => COMPANIONS,
                Mode::Realtime => Duration::from_nanos(config.period_ns / 4),
            },
            pending: None,
            odometry: None,
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

    fn take_odometry(&mut self, step: u64) -> Result<(), NodeError> {
        if let Some(odometries) = &mut self.odometries {
            // Odometry of later steps stays in the queue until its measurement is looked at.
            while self.odometry.is_none_or(|o| o.head.step < step) {
                let Some(odometry) = receive(odometries, &mut self.refused)? else { break };
                self.odometry = Some(odometry);
            }
        }
        Ok(())
    }

    fn is_complete(&self, imu: &Imu) -> bool {
        let step = imu.head.step;
        let follows = self.last.as_ref().is_some_and(|l| l.head.step + 1 == step);
        // After a miss commands are not coming, and waiting for each would make the next answers late as well.
        let command = !follows
            || self.gate.applied().flags & whirlstand_msgs::flags::HELD != 0
            || step.checked_sub(self.lag).is_none_or(|needed| self.history.get(needed).is_some());
        let odometry = self.odometries.is_none() || self.odometry.is_some_and(|o| o.head.step >= step);
        command && odometry
    }

    fn answer(&mut self, imu: &Imu) -> Result<(), NodeError> {
        let step = imu.head.step;
        let steps_to_predict = match &self.last {
            Some(last) if step == last.head.step => return Ok(self.estimates.send_again(last)?),
            Some(last) if step < last.head.step => {
                tracing::warn!(step, "the plant began a new run: starting the filter anew");
                self.restart();
                0
            }
            Some(last) if step - last.head.step > LONGEST_GAP => {
                tracing::warn!(
                    step,
                    last = last.head.step,
                    "too many measurements are missing: starting anew"
                );
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
        let odometry = self.odometry.filter(|o| o.head.step == step);
        let clean = self.filter.step(imu, odometry.as_ref(), &u_before, &u_now);
        self.refused += u64::from(!clean);
        let estimate = self.last.insert(self.filter.estimate(imu.head));
        self.estimates.send(estimate)?;
        self.steps += 1;
        Ok(())
    }

    /// Brings the gate to what was in force over `[t_i-1, t_i)`, which is command i-2.
    fn follow(&mut self, i: u64) {
        if let Some(awaited) = i.checked_sub(2) {
            if let Some(command) = self.history.get(awaited) {
                // The plant counts faults; here only the outcome matters.
                let _ = self.gate.offer(command, awaited);
            }
            self.gate.close(self.lockstep);
        }
    }

    /// What acts at the moment of measurement `step`: command `step` - 1, which the plant had before it measured.
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
        report.lost = [self.commands.lost(), self.odometries.as_ref().map_or(0, Subscriber::lost)]
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
                    // Between two measurements there is time for what the next one needs.
                    if self.last.as_ref().is_some_and(|l| self.history.get(l.head.step).is_none()) {
                        self.take_commands()?;
                    }
                    return Ok(Turn::Idle);
                }
            },
        };
        self.take_odometry(imu.head.step)?;
        if !self.is_complete(&imu) {
            self.take_commands()?;
            if !self.is_complete(&imu) && clock.now().saturating_duration_since(since) < self.companions {
                self.pending = Some((imu, since));
                return Ok(Turn::Idle);
            }
        }
        self.answer(&imu)?;
        if clock.is_exact() {
            self.peers.record_latency(clock.now().saturating_duration_since(since));
        }
        Ok(Turn::Worked)
    }

    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError> {
        self.count();
        self.peers.turn(now)
    }

    fn wake_at(&self) -> Instant {
        let due = self.peers.due();
        self.pending.map_or(due, |(_, since)| due.min(since + self.companions))
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
