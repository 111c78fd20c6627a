//! An autopilot that replaces estimator and controller: it flies the bench's vehicle.
//!
//! On `Imu` j the node derives the full sensors from `Truth` j, sends them to the autopilot, receives its
//! actuator outputs, and publishes command j. An autopilot in lockstep is waited for; a free-running one has
//! half a period to answer, and its newest outputs count.
//!
//! Before the run the vehicle is at rest at its start, and its sensors are streamed in real time while the
//! plant waits for command 0: the autopilot starts, its estimator settles, and it is armed. Then the run
//! begins.
//!
//! Only neutral inputs are sent before the autopilot is armed and after it disarms. Outputs that are too old,
//! not finite, or missing because the link is lost give no command: the plant holds the last one, then goes
//! to its failsafe, and the log contains the reason.

pub(super) mod constant;
mod errors;
mod exchange;
mod inbox;
pub(super) mod links;
mod pace;
mod stand;
pub(super) mod state;
mod tally;
mod waiting;

use std::time::{Duration, Instant};

use whirlstand_bridge::autopilot::{Autopilot, AutopilotConfig, Event, Parts, Rc, Stage};
use whirlstand_bridge::mixer::Mixer;
use whirlstand_bridge::sensors::{SensorModel, Sensors, StateMap};
use whirlstand_bus::{Bus, Publisher};
use whirlstand_msgs::{Command, Head, Health, Message, NodeState, Setpoint, flags};

use crate::clock::{Clock, Turn};
use crate::config::{Mode, NodeConfig, Role};
use crate::error::NodeError;
use crate::follower::Follower;
use crate::gate::InputLimits;
use crate::peers::Peers;
use crate::setup::Setup;
use constant::constant_sensors;
use errors::StandingErrors;
use exchange::exchange;
use inbox::{Inbox, VehicleSample};
use links::Links;
use state::{Fault, Flight};
use tally::{Tally, tell};
use waiting::Waiting;

/// Duration of the disarmed pilot's channels at the end: several of their periods.
const DISARM_TIME: Duration = Duration::from_millis(100);

/// The node of an autopilot in the loop.
pub struct Hil {
    inbox: Inbox,
    commands: Publisher<Command>,
    exchanges: Publisher<whirlstand_msgs::Autopilot>,
    setpoints: Publisher<Setpoint>,
    peers: Peers,
    autopilot: Box<dyn Autopilot>,
    name: &'static str,
    links: Links,
    model: SensorModel,
    states: StateMap,
    mixer: Mixer,
    limits: InputLimits,
    rc: Rc,
    flight: Flight,
    /// True when the wall clock sets the pace of the loop.
    is_realtime: bool,
    /// Time of the first unanswered sensor message, and whether an autopilot that is slower than the loop was
    /// reported.
    awaited_since: Option<Instant>,
    told_slow: bool,
    /// Longest wait for an answer.
    patience: Duration,
    /// Longest wait for an autopilot that flies, and the time since which it is awaited.
    start_timeout: Duration,
    awaited_to_fly: Option<Instant>,
    period: Duration,
    /// Last sampled motion of the vehicle.
    at: Option<VehicleSample>,
    standing: StandingErrors,
    /// Last sensors sent.
    sensed: Option<Sensors>,
    /// Time of the next sensor message while the vehicle waits at rest.
    stand_due: Instant,
    /// Time of the last sensor message.
    sensed_at: Instant,
    /// Number of periods without a sensor message, because the autopilot had not answered.
    held_back: u64,
    last: Option<Command>,
    origin: Instant,
    steps: u64,
    tally: Tally,
    waits: Waiting,
}

impl Hil {
    /// Prepares sensors and mixer, and opens the ports.
    ///
    /// # Errors
    /// [`NodeError`] for a vehicle without attitude, a mixer that does not fit, or ports that cannot be opened.
    pub fn open(
        bus: &Bus,
        config: &NodeConfig,
        setup: &Setup,
        options: &AutopilotConfig,
    ) -> Result<Self, NodeError> {
        let vehicle = &setup.vehicle;
        let lockstep = config.mode == Mode::Lockstep;
        let Parts { states, mixer, rc } = options
            .parts(vehicle, lockstep, 1e9 / config.period_ns as f64)
            .map_err(|e| NodeError::Config {
                field: format!("bridge.{}", e.path.join(".")),
                value: options.kind.autopilot().into(),
                reason: e.message,
            })?;
        let links = Links::new(options)?;
        let period = Duration::from_nanos(config.period_ns);
        let model = SensorModel::new(options.sensors.clone(), config.period_ns, config.seed);
        let standing = StandingErrors::of(config, setup)?;
        let mut drawn = standing.clone();
        if let Some(warning) = constant_sensors(options.kind, &model, || drawn.draw()) {
            tracing::warn!("{warning}");
        }
        Ok(Self {
            inbox: Inbox::open(bus, vehicle)?,
            commands: bus.publisher()?,
            exchanges: bus.publisher()?,
            sensed: None,
            standing,
            setpoints: bus.publisher()?,
            peers: Peers::open(bus, Role::Controller, vec![])?.begin_disarmed(),
            autopilot: options.autopilot(config.period_ns),
            name: options.kind.autopilot(),
            links,
            model,
            states,
            limits: setup.limits,
            flight: Flight::new(&options.flight, options.mixer.frame),
            mixer,
            waits: Waiting::new(options.kind.autopilot(), rc.grace(), Instant::now()),
            rc,
            is_realtime: !lockstep,
            awaited_since: None,
            told_slow: false,
            patience: Duration::from_secs_f64(options.flight.answer_timeout_s),
            start_timeout: Duration::from_secs_f64(config.start_timeout_s),
            awaited_to_fly: None,
            period,
            at: None,
            stand_due: Instant::now(),
            sensed_at: Instant::now(),
            held_back: 0,
            last: None,
            origin: Instant::now(),
            steps: 0,
            tally: Tally::new(options.kind.autopilot()),
        })
    }

    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    /// Receives the autopilot's messages.
    fn listen(&mut self) {
        let now = self.now();
        self.links.receive(self.autopilot.as_mut(), now);
        while let Some(event) = self.autopilot.next() {
            match event {
                Event::Outputs(outputs) => {
                    self.tally.outputs(&outputs, &self.mixer);
                    self.flight.take(outputs, now);
                }
                Event::Restarted => {
                    tracing::warn!("{} restarted: outputs are neutral until it is armed again", self.name);
                    self.flight.forget();
                }
            }
        }
        while let Some(note) = self.autopilot.note() {
            tell(&note);
        }
        if let Some(why) = self.links.take_lost() {
            tracing::warn!("{why}: neutral until {} is armed again", self.name);
            self.flight.forget();
        }
    }

    /// Receives all steps that have arrived; returns the number of the newest, if any.
    fn next_step(&mut self) -> Result<Option<u64>, NodeError> {
        let before = self.at.map(|at| at.step);
        let seen = self.inbox.drain(&self.states)?;
        if let Some(at) = seen {
            if before.is_some_and(|before| at.step < before) {
                tracing::warn!(step = at.step, "the plant started a new run");
                self.model.rewind();
            }
            self.at = Some(at);
        }
        Ok(seen.map(|at| at.step))
    }

    /// Reads the sensors `periods` after the last reading and sends them.
    fn sense(&mut self, periods: u64) {
        let Some(VehicleSample { motion, errors, .. }) = self.at else { return };
        let periods = periods + std::mem::take(&mut self.held_back);
        let errors = if self.flight.has_begun() { errors } else { self.standing.draw() };
        let sensors = self.model.step_after(periods, &motion, &errors);
        self.send(&sensors);
    }

    fn send(&mut self, sensors: &Sensors) {
        let now = self.now();
        let linked = self.flight.is_fresh(now);
        let before = self.rc.stage();
        let stage = self.rc.turn(linked, self.flight.may_arm(), now);
        if stage != before {
            match stage {
                Stage::Off => tracing::warn!("disarming {}", self.name),
                Stage::Grace => tracing::info!("{} is connected: sticks neutral, switch off", self.name),
                Stage::Arming => tracing::info!("arming {}: switch on, throttle low", self.name),
                Stage::Flying => tracing::info!("throttle up"),
            }
        }
        self.sensed_at = Instant::now();
        self.sensed = Some(*sensors);
        let links = &mut self.links;
        self.autopilot.sense(sensors, &self.rc, now, &mut |port, bytes| links.send(port, bytes));
    }

    /// Publishes the command of a step, if there is one.
    fn answer(&mut self, step: u64) -> Result<(), NodeError> {
        let now = self.now();
        let mut u = [0.0; whirlstand_msgs::MAX_INPUTS];
        let count = self.mixer.inputs();
        let verdict = self.flight.inputs(&self.mixer, &self.limits, now, &mut u[..count]);
        if let Some(change) = self.flight.take_change() {
            match change {
                Some(fault) => tracing::warn!(step, "{}: {}", self.name, fault.text()),
                None => tracing::warn!(step, "{} flies again", self.name),
            }
        }
        self.peers.set_state(match verdict {
            Ok(()) => NodeState::Running,
            Err(Fault::Disarmed) => NodeState::Disarmed,
            Err(Fault::Silent | Fault::NotFinite) => NodeState::Failsafe,
        });
        let head = Head { seq: 0, step, stamp_ns: step * self.period.as_nanos() as u64 };
        let outputs = self.flight.newest(now);
        let mut told = exchange(self.sensed.as_ref(), self.rc.pulses(), outputs, verdict);
        told.head = head;
        self.exchanges.send(&told)?;
        if let Err(fault) = verdict
            && fault != Fault::Disarmed
        {
            let withheld = Command { head, flags: flags::WITHHELD, ..Command::zeroed() };
            return Ok(self.commands.send(&withheld)?);
        }
        let command = Command { head, count: count as u32, u, ..Command::zeroed() };
        self.commands.send(&command)?;
        self.setpoints.send(&Setpoint { head: command.head, ..Setpoint::zeroed() })?;
        self.last = Some(command);
        self.steps += 1;
        Ok(())
    }

    fn fly(&mut self, clock: &mut Clock) -> Result<Turn, NodeError> {
        let before = self.at.map(|at| at.step);
        let Some(step) = self.next_step()? else {
            self.listen();
            return Ok(Turn::Idle);
        };
        let since = clock.now();
        match before {
            Some(last) if last == step => {
                if let Some(command) = self.last.filter(|c| c.head.step == step) {
                    self.commands.send_again(&command)?;
                }
                return Ok(Turn::Worked);
            }
            _ => {}
        }
        let periods = before.map_or(1, |last| step.saturating_sub(last));
        if self.is_slow() {
            // The rotation of this period is added to the next reading: the gyroscope's integral must be
            // complete.
            self.held_back += periods;
        } else {
            self.sense(periods);
        }
        self.await_answer();
        self.answer(step)?;
        if clock.is_exact() {
            self.peers.record_latency(clock.now().saturating_duration_since(since));
        }
        Ok(Turn::Worked)
    }

    /// Disarms the autopilot while its link still exists, repeatedly because datagrams can be lost.
    fn disarm(&mut self) {
        self.flight.forget();
        let until = Instant::now() + DISARM_TIME;
        while Instant::now() < until {
            self.sense(1);
            let next = Instant::now() + self.period;
            while self.links.wait(next, Duration::ZERO) {
                self.listen();
            }
        }
    }

    fn count(&mut self) {
        let (counts, strangers) = (self.autopilot.counts(), self.links.refused());
        let report = &mut self.peers.report;
        report.head.step = self.last.map_or(0, |l| l.head.step);
        report.steps = self.steps;
        report.lost = self.inbox.lost().saturating_add(self.tally.lost(counts));
        report.rejected = self.inbox.refused()
            + counts.dropped()
            + self.flight.refused()
            + self.tally.beyond()
            + strangers.sum();
        self.tally.look(counts, strangers);
    }
}

impl Follower for Hil {
    fn turn(&mut self, clock: &mut Clock) -> Result<Turn, NodeError> {
        if self.flight.has_begun() { self.fly(clock) } else { self.stand() }
    }

    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError> {
        self.count();
        self.peers.turn(now)
    }

    fn wake_at(&self) -> Instant {
        if self.flight.has_begun() || self.at.is_none() {
            self.peers.due()
        } else {
            self.peers.due().min(self.stand_due)
        }
    }

    fn is_due(&self, now: Instant) -> bool {
        self.peers.is_due(now)
    }

    fn is_starting(&self) -> bool {
        self.peers.is_starting()
    }

    fn stop(&mut self) -> Result<Health, NodeError> {
        if self.rc.stage() != Stage::Off {
            self.disarm();
        }
        self.count();
        self.tally.end(self.links.unsent(), self.links.refused());
        self.peers.set_state(NodeState::Stopping);
        self.peers.publish(Instant::now())?;
        Ok(self.peers.report)
    }
}
