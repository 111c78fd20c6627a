//! The controller: computes commands from estimated states.
//!
//! On `Estimate` j it computes command j, which is in force over `[t_j+1, t_j+2)`; the law accounts for that
//! period of latency with the command that it sent for j-1. It can join at any step. A step number that goes
//! back means that the plant was restarted, and resets the law; a repeated step is answered with the same
//! command again.

mod caution;
mod draftsman;
mod hand;
mod heirs;
mod law;
mod outside;
mod profile;

use std::time::Instant;

use whirlstand_bus::{Bus, Publisher, Subscriber};
use whirlstand_msgs::{Command, Estimate, Head, Health, Message, NodeState, Setpoint, flags};

use crate::clock::{Clock, Turn};
use crate::config::{NodeConfig, Role};
use crate::error::NodeError;
use crate::follower::Follower;
use crate::gate::InputLimits;
use crate::notices::{Notice, say};
use crate::peers::Peers;
use crate::ports::receive;
use crate::setup::Setup;
use caution::Caution;
use heirs::InCharge;
pub(crate) use law::Law;
pub use law::{controller_of, left_out};
use outside::Outside;
pub use outside::PILOT_TOPIC;
pub(crate) use profile::Profile;

/// Queue length for estimates.
const DEPTH: usize = 64;

/// The controller as a state machine.
pub struct Controller {
    estimates: Subscriber<Estimate>,
    outside: Outside,
    caution: Caution,
    commands: Publisher<Command>,
    setpoints: Publisher<Setpoint>,
    telemetry: bool,
    always_telemetry: bool,
    peers: Peers,
    law: InCharge,
    profile: Profile,
    last: Option<Command>,
    states: usize,
    limits: InputLimits,
    steps: u64,
    refused: u64,
}

impl Controller {
    /// Designs the law and opens the ports.
    ///
    /// # Errors
    /// [`NodeError`] for a law that cannot be designed for the vehicle, or ports that cannot be opened.
    pub fn open(bus: &Bus, config: &NodeConfig, setup: &Setup) -> Result<Self, NodeError> {
        let profile = Profile::new(config, &setup.vehicle)?;
        let law = InCharge::open(bus, config, setup)?;
        let listens_to = if config.peers.contains(&Role::Estimator) { vec![Role::Estimator] } else { vec![] };
        // Initial states of the plant are not known here: the bounds are those of a vehicle at rest.
        let bounds = setup.vehicle.state_bounds(&vec![0.0; setup.vehicle.states.len()]);
        Ok(Self {
            estimates: bus.subscriber(DEPTH)?,
            outside: Outside::open(bus, config, bounds, setup.limits)?,
            caution: Caution::open(bus, config)?,
            commands: bus.publisher()?,
            setpoints: bus.publisher()?,
            telemetry: config.telemetry,
            always_telemetry: config.telemetry,
            peers: Peers::open(bus, Role::Controller, listens_to)?,
            law,
            profile,
            last: None,
            states: setup.vehicle.states.len(),
            limits: setup.limits,
            steps: 0,
            refused: 0,
        })
    }

    fn answer(&mut self, estimate: &Estimate) -> Result<(), NodeError> {
        let step = estimate.head.step;
        if estimate.count as usize != self.states || estimate.x[..self.states].iter().any(|v| !v.is_finite())
        {
            self.refused += 1;
            let withheld = Command { head: estimate.head, flags: flags::WITHHELD, ..Command::zeroed() };
            return Ok(self.commands.send(&withheld)?);
        }
        match self.last {
            Some(last) if step == last.head.step => return Ok(self.commands.send_again(&last)?),
            Some(last) if step < last.head.step => {
                say(Notice::NewRun { step, then: "resetting the law" });
                self.law.reset();
                self.profile.rewind();
                self.outside.forget();
                self.caution.forget();
                self.last = None;
            }
            _ => {}
        }
        let withholds = self.caution.withholds(step, &mut self.refused)?;
        let before = self.last.map_or_else(|| self.limits.neutral(), |last| last.u);
        self.outside.take(estimate.head, self.law.law(), &before)?;
        let by_hand = self.outside.hand().copied();
        let setpoint = self.outside.setpoint(self.profile.at(estimate.head));
        let mut command =
            Command { head: estimate.head, count: self.limits.count as u32, ..Command::zeroed() };
        let (x, u, refused) = (&estimate.x, &mut command.u, &mut self.refused);
        command.flags = self.law.step(step, x, setpoint, by_hand.as_ref(), u, refused)?;
        if withholds {
            command = Command { head: estimate.head, flags: flags::WITHHELD, ..Command::zeroed() };
        }
        self.commands.send(&command)?;
        if self.telemetry {
            self.setpoints.send(setpoint)?;
        }
        self.last = Some(command);
        self.steps += 1;
        Ok(())
    }

    fn count(&mut self) {
        let report = &mut self.peers.report;
        report.head.step = self.last.map_or(0, |l| l.head.step);
        report.steps = self.steps;
        report.lost = self.estimates.lost();
        report.rejected = self.refused + self.outside.refused();
    }
}

impl Follower for Controller {
    fn turn(&mut self, clock: &mut Clock) -> Result<Turn, NodeError> {
        let Some(estimate) = receive(&mut self.estimates, &mut self.refused)? else { return Ok(Turn::Idle) };
        let since = clock.now();
        self.answer(&estimate)?;
        if clock.is_exact() {
            self.peers.record_latency(clock.now().saturating_duration_since(since));
        }
        Ok(Turn::Worked)
    }

    fn housekeeping(&mut self, now: Instant) -> Result<(), NodeError> {
        if self.peers.is_due(now) {
            let start = Head { seq: 0, step: 0, stamp_ns: 0 };
            self.outside.attend(self.last.map_or(start, |last| last.head))?;
            self.telemetry = self.always_telemetry || self.setpoints.has_subscribers()?;
        }
        self.count();
        self.peers.turn(now)
    }

    fn wake_at(&self) -> Instant {
        self.peers.due()
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
