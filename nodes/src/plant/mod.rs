//! The plant: simulates the vehicle and its sensors, applies commands and sets the pace.
//!
//! At `t_j` the plant closes the [`Gate`] for command j-1, publishes `Truth`, `Odometry`, `Disturbance` and
//! last `Imu`, and integrates to `t_j+1` while the others work. Step 0 is special in both modes: its inputs
//! are neutral, and the clock of a realtime run starts when command 0 has arrived, so that no node's start-up
//! counts as a miss.

mod latencies;
mod missed;
mod outside;
mod pace;
mod phase;
pub(crate) mod simulation;
mod start;
mod waiting;

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{Command, NodeState};

use crate::clock::{Clock, Turn};
use crate::config::{Mode, NodeConfig, Role};
use crate::error::NodeError;
use crate::gate::Gate;
use crate::notices::{Notice, say};
use crate::os::MonotonicTime;
use crate::peers::Peers;
use crate::ports::receive;
use crate::setup::Setup;
use latencies::latencies;
use missed::Missed;
pub use outside::INJECT_TOPIC;
use pace::Paces;
use phase::Phase;
use simulation::Simulation;
use waiting::{Waiting, whom};

/// Queue length for commands; one is awaited at a time.
const COMMAND_DEPTH: usize = 16;

/// Time by which the wait for the first command of an autopilot is longer than its bridge's, which ends first,
/// because it knows the reason.
const BRIDGE_FIRST: Duration = Duration::from_secs(2);

/// Longest wait for the last command when the run is ended before its last step.
const LAST_COMMAND: Duration = Duration::from_millis(250);

/// The plant as a state machine: [`Plant::turn`] does all work that is possible now.
pub struct Plant {
    mode: Mode,
    period_ns: u64,
    steps: u64,
    start_timeout: Duration,
    /// Longest wait for the first command.
    answer_timeout: Duration,
    simulation: Simulation,
    gate: Gate,
    commands: Subscriber<Command>,
    /// Nodes for which a lockstep plant waits.
    paces: Paces,
    peers: Peers,
    phase: Phase,
    /// Next step.
    step: u64,
    /// Wait for the answer to the last step.
    waiting: Waiting,
    /// True when the awaited command has been noticed.
    answered: bool,
    /// Time of bench time 0 in a realtime run.
    origin: MonotonicTime,
    missed: Missed,
    refused: u64,
    was_failsafe: bool,
    latencies: Histogram<u64>,
    /// Beginning of the loop, when command 0 arrived.
    began: Option<Instant>,
    looped: Duration,
    /// Reason for an end before the last step.
    diverged: Option<NodeError>,
}

impl Plant {
    /// Opens the ports and prepares step 0.
    ///
    /// # Errors
    /// [`NodeError`] for a vehicle or configuration that cannot run, or ports that cannot be opened.
    pub fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let plant = &config.plant;
        let paces = Paces::open(bus, config)?;
        let commands = bus.subscriber(COMMAND_DEPTH)?;
        let simulation = Simulation::open(bus, config, setup)?;
        let mut listens_to = config.peers.clone();
        if config.recorder.is_some() && !listens_to.contains(&Role::Recorder) {
            listens_to.push(Role::Recorder);
        }
        let peers = Peers::open(bus, Role::Plant, listens_to)?;
        let now = Instant::now();
        let has_autopilot = config.bridge.as_ref().is_some_and(|bridge| !bridge.kind.is_vehicle());
        let start_timeout = Duration::from_secs_f64(config.start_timeout_s);
        Ok(Self {
            mode: config.mode,
            period_ns: config.period_ns,
            steps: config.steps,
            start_timeout,
            answer_timeout: if has_autopilot { start_timeout + BRIDGE_FIRST } else { start_timeout },
            simulation,
            gate: Gate::new(setup.limits, plant.misses_to_failsafe),
            commands,
            paces,
            peers,
            phase: Phase::Joining { until: now + start_timeout },
            step: 0,
            waiting: Waiting::new(plant.answer_timeout_s.map(Duration::from_secs_f64), now),
            answered: false,
            origin: MonotonicTime(0),
            missed: Missed::new(),
            refused: 0,
            was_failsafe: false,
            latencies: latencies()?,
            began: None,
            looped: Duration::ZERO,
            diverged: None,
        })
    }

    /// Does all work that is possible now. In a realtime loop it only receives commands; [`Plant::tick`] does
    /// the steps.
    ///
    /// # Errors
    /// [`NodeError`] when the transport fails, or no node appears at the start.
    pub fn turn(&mut self, clock: &mut Clock) -> Result<Turn, NodeError> {
        match self.phase {
            Phase::Looping => self.turn_in_loop(clock),
            Phase::Joining { until } => self.join(clock, until),
            Phase::Answering { until, repeat } => self.await_first_answer(clock, until, repeat),
            Phase::Ending { until } => self.end(clock, until),
            Phase::Ended => Ok(Turn::Ended),
        }
    }

    /// Time of the next call even if no message arrives.
    pub fn wake_at(&self) -> Instant {
        let due = self.peers.due();
        match self.phase {
            Phase::Looping => self.waiting.wake_at(due),
            Phase::Joining { until } => due.min(until),
            Phase::Ending { until } => until.map_or(due, |until| due.min(until)),
            Phase::Answering { until, repeat } => due.min(until).min(repeat),
            Phase::Ended => due,
        }
    }

    /// Deadline of the next step, in a realtime loop.
    pub fn deadline(&self) -> Option<MonotonicTime> {
        let in_loop = self.phase == Phase::Looping && self.mode == Mode::Realtime;
        in_loop.then(|| MonotonicTime(self.origin.0 + self.step * self.period_ns))
    }

    /// Performs the step whose deadline has come, in realtime. When the plant itself was not running for
    /// whole periods, bench time stands still for these and each counts as a miss.
    ///
    /// # Errors
    /// [`NodeError`] when the transport fails.
    pub fn tick(&mut self, clock: &mut Clock) -> Result<(), NodeError> {
        let Some(deadline) = self.deadline() else { return Ok(()) };
        self.take_commands(clock)?;
        self.origin.0 += self.missed.overrun(deadline, self.period_ns) * self.period_ns;
        let was_answered = self.answered;
        self.advance(clock, false)?;
        // A report is published after an answer, when nobody waits for the plant; without one, after the measurement.
        if was_answered { Ok(()) } else { self.housekeeping(self.waiting.since()) }
    }

    /// Ends the run normally after the last published step.
    pub fn stop(&mut self) {
        self.phase = match self.phase {
            Phase::Looping | Phase::Answering { .. } if self.step > 0 => {
                Phase::Ending { until: Some(self.waiting.since() + LAST_COMMAND) }
            }
            Phase::Ending { until: None } => Phase::Ending { until: Some(Instant::now() + LAST_COMMAND) },
            Phase::Ending { .. } => return,
            _ => Phase::Ended,
        };
    }

    /// Reason for the end before the last step, if the vehicle left its model. The log is complete by then.
    pub fn take_divergence(&mut self) -> Option<NodeError> {
        self.diverged.take()
    }

    /// Number of steps done.
    pub fn steps_done(&self) -> u64 {
        self.step
    }

    /// Times from publishing `Imu` to receiving its command, ns, for command 1 and later.
    pub fn latencies(&self) -> &Histogram<u64> {
        &self.latencies
    }

    /// Start times of the periods of a realtime run whose command did not arrive in time, `CLOCK_MONOTONIC`,
    /// ns; the first few thousand.
    pub(crate) fn missed(&self) -> &[u64] {
        self.missed.began()
    }

    /// Duration of the loop, from command 0 to the last step.
    pub fn looped_for(&self) -> Duration {
        self.looped
    }

    /// The health report of the plant.
    pub fn health(&mut self) -> &whirlstand_msgs::Health {
        self.count();
        &self.peers.report
    }

    fn turn_in_loop(&mut self, clock: &mut Clock) -> Result<Turn, NodeError> {
        let had = self.answered;
        self.take_commands(clock)?;
        if self.mode == Mode::Realtime {
            if had || !self.answered {
                return Ok(Turn::Idle);
            }
            self.housekeeping(clock.last())?;
            return Ok(Turn::Worked);
        }
        let now = clock.now();
        self.housekeeping(now)?;
        if !self.is_settled(now) {
            self.wait_on(now)?;
            return Ok(Turn::Idle);
        }
        if !self.paces.may_go_on(self.step, &mut self.peers)? {
            self.tell_wait(now);
            return Ok(Turn::Idle);
        }
        self.advance(clock, true)?;
        Ok(Turn::Worked)
    }

    /// True when the current step can be closed in lockstep: it was answered, or its answer cannot come,
    /// because the responsible process was replaced. A wall-clock limit applies only if configured.
    fn is_settled(&mut self, now: Instant) -> bool {
        let replaced = [Role::Estimator, Role::Controller].map(|role| self.peers.take_replaced(role));
        self.gate.is_answered() || replaced.contains(&true) || self.waiting.is_over(now)
    }

    /// Repeats the measurement, and reports for whom the plant waits.
    fn wait_on(&mut self, now: Instant) -> Result<(), NodeError> {
        if self.waiting.asks_again(now) {
            self.simulation.repeat_measurement()?;
        }
        self.tell_wait(now);
        Ok(())
    }

    fn tell_wait(&mut self, now: Instant) {
        let Self { waiting, peers, gate, phase, step, .. } = self;
        let (joining, step) = (matches!(phase, Phase::Joining { .. }), step.saturating_sub(1));
        waiting.tell(now, || whom(peers, gate, joining, step, now));
    }

    fn end(&mut self, clock: &mut Clock, until: Option<Instant>) -> Result<Turn, NodeError> {
        self.take_commands(clock)?;
        let now = clock.now();
        self.housekeeping(now)?;
        if !self.is_settled(now) && until.is_none_or(|until| now < until) {
            if self.mode == Mode::Lockstep {
                self.wait_on(now)?;
            }
            return Ok(Turn::Idle);
        }
        self.looped = self.began.map_or(Duration::ZERO, |t| t.elapsed());
        self.waiting.end();
        self.peers.set_state(NodeState::Stopping);
        self.report(Instant::now())?;
        self.phase = Phase::Ended;
        Ok(Turn::Ended)
    }

    fn begin_ending(&mut self) -> Result<Turn, NodeError> {
        let until = (self.mode == Mode::Realtime).then_some(self.waiting.since() + LAST_COMMAND);
        self.phase = Phase::Ending { until };
        Ok(Turn::Worked)
    }

    fn take_commands(&mut self, clock: &mut Clock) -> Result<(), NodeError> {
        // Before step 0 is published no command can belong to this run.
        let Some(awaited) = self.step.checked_sub(1) else { return Ok(()) };
        while let Some(command) = receive(&mut self.commands, &mut self.refused)? {
            // Faults are counted by the gate, and reported with the plant's health.
            let _ = self.gate.offer(&command, awaited);
        }
        if self.gate.is_ready() && !self.answered {
            self.answered = true;
            // The answer to step 0 includes the start of a whole bench, or a pilot's arming.
            if clock.is_exact() && awaited > 0 {
                let latency = clock.now().saturating_duration_since(self.waiting.since());
                self.peers.record_latency(latency);
                self.latencies.saturating_record(latency.as_nanos() as u64);
            }
        }
        Ok(())
    }

    /// Performs step `self.step`.
    fn advance(&mut self, clock: &mut Clock, failsafe_at_once: bool) -> Result<(), NodeError> {
        let applied = if self.step == 0 { self.gate.applied() } else { self.gate.close(failsafe_at_once) };
        self.missed.closed(self.gate.misses(), self.deadline(), self.period_ns);
        self.answered = false;
        self.simulation.publish(self.step, &applied)?;
        self.waiting.begin(clock.now());
        self.simulation.integrate();
        self.step += 1;
        if self.gate.in_failsafe() != self.was_failsafe {
            self.announce();
        }
        if self.phase == Phase::Looping {
            self.diverged = self.simulation.left_model();
            if self.step == self.steps || self.diverged.is_some() || self.simulation.is_to_end() {
                self.begin_ending()?;
            }
        }
        Ok(())
    }

    fn announce(&mut self) {
        self.was_failsafe = self.gate.in_failsafe();
        let step = self.step - 1;
        if self.was_failsafe {
            self.peers.set_state(NodeState::Failsafe);
            say(Notice::Failsafe { step, misses: self.gate.misses() });
        } else {
            self.peers.set_state(NodeState::Running);
            say(Notice::FailsafeOver { step });
        }
    }

    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError> {
        if self.peers.is_due(now) { self.report(now) } else { Ok(()) }
    }

    fn report(&mut self, now: Instant) -> Result<(), NodeError> {
        self.count();
        self.simulation.attend(self.step.saturating_sub(1))?;
        self.peers.turn(now)
    }

    fn count(&mut self) {
        let report = &mut self.peers.report;
        report.head.step = self.step.saturating_sub(1);
        report.steps = self.step;
        report.deadline_misses = self.gate.misses() + self.missed.overruns();
        report.lost = self.commands.lost();
        report.rejected = self.gate.rejected() + self.refused + self.simulation.refused();
    }
}
