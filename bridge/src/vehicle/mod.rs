//! A real vehicle that replaces the plant: measurements in, channels out, with the gate between controller
//! and wire.
//!
//! [`Vehicle`] receives bytes, commands and the time, and returns bytes for its ports, measurements for the
//! bus and notes for the user. For any input, its outputs are within limits and rates, and leave neutral only
//! in [`Mode::Automatic`] or [`Mode::Manual`].

mod autopilot;
mod budget;
mod clock;
mod decide;
mod delivery;
mod figures;
mod ground;
mod handed_on;
mod inbound;
mod options;
mod outbound;
mod output;
mod receivers;
mod reported;
mod requests;
mod sent;
mod station;
mod telemetry;
mod warnings;

use std::time::Duration;

use whirlstand_msgs::{Imu, Odometry};

use crate::arming::{Arming, Mode, Policy, Reason};
use crate::channels::{CHANNELS, Input, Mapping, Steering};
use crate::config::{
    BridgeConfig, BridgeKind, ConfigError, MavlinkConfig, Output, PilotSource, SafetyConfig,
};
use crate::crsf;
use crate::forward::Forward;
use crate::mavlink::Signing;
pub use crate::note::Note;
use crate::note::Notes;
use crate::pilot::Pilot;
use crate::sbus;
use crate::sign_watch::SignWatch;
use crate::turning::OwnMotion;
use crate::watch::EstimateWatch;
use autopilot::Autopilot;
use budget::budget;
use delivery::Delivery;
pub use figures::Figures;
use ground::Ground;
pub use inbound::Received;
use options::{check_mavlink, check_safety, missing};
pub use telemetry::{FIELDS, Group, Refusals, Telemetry};

/// Time between two repeated outputs, while no command arrives.
const KEEP_ALIVE: Duration = Duration::from_millis(50);

/// Pause that no SBUS frame contains.
const SBUS_PAUSE: Duration = Duration::from_millis(3);

/// Ports of the bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Port {
    /// The link to the vehicle.
    Link = 0,
    /// The output for channels, where it is separate from the link.
    Output = 1,
    /// The pilot's receiver.
    Pilot = 2,
    /// The link to a ground station that listens.
    Ground = 3,
}

/// Properties of the bench for the bridge.
#[derive(Debug, Clone)]
pub struct Bench {
    /// Inputs in the vehicle's order.
    pub inputs: Vec<Input>,
    /// Angular acceleration due to the vehicle's own attitude.
    pub own: OwnMotion,
    /// Rate of the loop, Hz.
    pub rate_hz: f64,
    /// True when the vehicle file has positions or speeds.
    pub wants_odometry: bool,
    /// Secret key of a signed link, and the Unix time at the origin of `now`.
    pub signing: Option<Signing>,
}

enum Source {
    Mavlink(Box<Autopilot>),
    Crsf {
        parser: crsf::Parser,
        quality: Option<u8>,
        linked_at: Option<Duration>,
        timeout: Duration,
        warned: bool,
    },
}

/// The bridge to a vehicle, as a state machine.
pub struct Vehicle {
    safety: SafetyConfig,
    output: Output,
    mavlink: Option<MavlinkConfig>,
    source: Source,
    telemetry: Telemetry,
    mapping: Mapping,
    arming: Arming,
    watch: EstimateWatch,
    signs: SignWatch,
    pilot: Option<Pilot>,
    pilot_source: Option<PilotSource>,
    pilot_crsf: crsf::Parser,
    pilot_sbus: sbus::Parser,
    pilot_bytes_at: Duration,
    ground: Ground,
    explained: Option<Reason>,
    /// Time since which nobody has armed, and whether that was reported.
    waiting_since: Option<Duration>,
    told_who_arms: bool,
    /// Inputs as commanded by the controller, and as acting after limits, rates and mode.
    inputs: Vec<f64>,
    acting: Vec<f64>,
    command_at: Option<Duration>,
    command_timeout: Duration,
    finite: bool,
    out: [Vec<u8>; 4],
    sent_at: Option<Duration>,
    least_interval: Duration,
    released: bool,
    /// True while the channels are handed over to the vehicle's own radio for a check.
    lent: bool,
    outputs: u64,
    delivery: Delivery,
    notes: Notes,
}

/// Shortest time between two outputs at a largest rate, Hz; zero without one.
fn least_interval(kind: BridgeKind, rate_hz: Option<f64>) -> Result<Duration, ConfigError> {
    let Some(rate_hz) = rate_hz else { return Ok(Duration::ZERO) };
    if rate_hz > 0.0 && rate_hz.is_finite() {
        return Ok(Duration::from_secs_f64(1.0 / rate_hz));
    }
    let message = "a rate above 0 is expected; leave it out for one output a command";
    Err(ConfigError::new(&[kind.name(), "output_rate_hz"], message))
}

/// Link to the vehicle with its output format.
struct VehicleLink {
    source: Source,
    output: Output,
    /// Configured largest rate of outputs, Hz.
    rate_hz: Option<f64>,
    mavlink: Option<MavlinkConfig>,
}

impl VehicleLink {
    fn new(
        config: &BridgeConfig,
        bench: &mut Bench,
        wants_rc: bool,
        timeout: Duration,
    ) -> Result<Self, ConfigError> {
        match config.kind {
            BridgeKind::Mavlink => {
                let own = config.options.mavlink.as_ref().ok_or_else(|| missing(config.kind))?;
                check_mavlink(own)?;
                let (rate, odometry, signing) = (bench.rate_hz, bench.wants_odometry, bench.signing.take());
                let autopilot = Autopilot::new(own, rate, odometry, wants_rc, timeout, signing);
                let source = Source::Mavlink(Box::new(autopilot));
                Ok(Self {
                    source,
                    output: own.output,
                    rate_hz: own.output_rate_hz,
                    mavlink: Some(own.clone()),
                })
            }
            BridgeKind::Crsf => {
                let own = config.options.crsf.as_ref().ok_or_else(|| missing(config.kind))?;
                let parser = crsf::Parser::new();
                let source = Source::Crsf { parser, quality: None, linked_at: None, timeout, warned: false };
                Ok(Self { source, output: Output::Crsf, rate_hz: own.output_rate_hz, mavlink: None })
            }
            other => {
                let message = format!("the bridge {other} is not one to a vehicle");
                Err(ConfigError::new(&[other.name()], message))
            }
        }
    }
}

impl Vehicle {
    /// A bridge without received data yet.
    ///
    /// # Errors
    /// [`ConfigError`] for invalid options.
    pub fn new(config: &BridgeConfig, mut bench: Bench) -> Result<Self, ConfigError> {
        let options = &config.options;
        let safety = options.safety.clone();
        check_safety(&safety, config)?;
        let pilot = options.pilot.as_ref().map(Pilot::new).transpose()?;
        let pilot_source = options.pilot.as_ref().map(|p| p.source);
        let timeout = Duration::from_secs_f64(safety.link_timeout_s);
        let wants_rc = pilot_source == Some(PilotSource::Mavlink);
        let link = VehicleLink::new(config, &mut bench, wants_rc, timeout)?;
        let (output, rate) = (link.output, link.rate_hz);
        let mut least_interval = least_interval(config.kind, rate)?;
        let budget = budget(config, output, rate, bench.rate_hz)?;
        let policy = Policy {
            arm: safety.arm,
            stale: Duration::from_secs_f64(safety.stale_s),
            recover_after: safety.recover_after_s.map(Duration::from_secs_f64),
        };
        let mut mapping = Mapping::new(&options.channels, &bench.inputs, pilot.is_some())?;
        if matches!(output, Output::Crsf | Output::Sbus) {
            mapping = mapping.with_switches(options.pilot.as_ref().map(|p| [p.arm, p.automatic]));
        }
        let mut notes = Notes::default();
        if let Some((line, text)) = budget {
            least_interval = least_interval.max(line);
            notes.warn(text);
        }
        let period = Duration::from_secs_f64(1.0 / bench.rate_hz).max(least_interval);
        let forward = Forward::new(link.mavlink.as_ref().map_or("", |own| &own.link), period);
        mapping.sentences(&bench.inputs).into_iter().for_each(|sentence| notes.info(sentence));
        Ok(Self {
            telemetry: Telemetry::new(&options.measured)?,
            mapping,
            signs: SignWatch::new(&bench.inputs, &bench.own),
            arming: Arming::new(policy),
            watch: EstimateWatch::new(safety.max_innovation),
            command_timeout: Duration::from_secs_f64(safety.command_timeout_s),
            safety,
            output,
            mavlink: link.mavlink,
            source: link.source,
            pilot,
            pilot_source,
            pilot_crsf: crsf::Parser::new(),
            pilot_sbus: sbus::Parser::new(),
            pilot_bytes_at: Duration::ZERO,
            ground: Ground::new(forward),
            explained: None,
            waiting_since: None,
            told_who_arms: false,
            inputs: vec![0.0; bench.inputs.len()],
            acting: vec![0.0; bench.inputs.len()],
            command_at: None,
            finite: true,
            out: Default::default(),
            sent_at: None,
            least_interval,
            released: false,
            lent: false,
            outputs: 0,
            delivery: Delivery::default(),
            notes,
        })
    }

    /// Continues after a restart of this bridge during a run: no source is in charge until it is armed again.
    pub fn come_back(&mut self) {
        let mode = self.arming.come_back();
        self.announce(mode);
    }

    /// Processes a command that answers the newest measurement, and sends the output.
    pub fn command(&mut self, inputs: &[f64], now: Duration) {
        self.finite = inputs.len() == self.inputs.len() && inputs.iter().all(|u| u.is_finite());
        if self.finite {
            self.inputs.copy_from_slice(inputs);
        }
        self.command_at = Some(now);
        self.decide(now);
        if self.sent_at.is_none_or(|at| now.saturating_sub(at) >= self.least_interval) {
            self.send(now);
        }
    }

    /// Processes an estimate: states, normalised innovation squared and its degrees of freedom.
    pub fn estimate(&mut self, states: &[f64], nis: f64, dof: u32, now: Duration) {
        // While its commands are not applied the estimator's predictions are wrong.
        let dof = if self.arming.mode() == Mode::Automatic { dof } else { 0 };
        self.watch.observe(states, nis, dof, now);
    }

    /// True when a condition failed in flight and nobody has armed again.
    pub fn has_failed(&self) -> bool {
        matches!(self.arming.mode(), Mode::Failed(_))
    }

    /// Ends the run: disarms, and releases an override.
    pub fn end(&mut self, now: Duration) {
        if let Some(mode) = self.arming.end() {
            self.announce(mode);
        }
        self.mapping.reset();
        self.send(now);
        let overridden = self.overridden();
        if let (Source::Mavlink(autopilot), Output::RcOverride) = (&mut self.source, self.output)
            && autopilot.is_known()
        {
            let message = output::rc_override(None, &overridden, autopilot.target());
            autopilot.send(&message, now, &mut self.out[Port::Link as usize]);
        }
    }

    /// Time-dependent work: detects silence, repeats outputs, sends heartbeats. To be called by
    /// [`Vehicle::wake_at`] at the latest.
    pub fn poll(&mut self, now: Duration) {
        self.decide(now);
        if let Source::Mavlink(autopilot) = &mut self.source {
            autopilot.poll(now, &mut self.notes, &mut self.out[Port::Link as usize]);
        }
        if self.sent_at.is_none_or(|at| now.saturating_sub(at) >= KEEP_ALIVE) {
            self.send(now);
        }
    }

    /// Latest time of the next call of [`Vehicle::poll`].
    pub fn wake_at(&self, now: Duration) -> Duration {
        let alive = self.sent_at.map_or(now, |at| at + KEEP_ALIVE);
        match &self.source {
            Source::Mavlink(autopilot) => alive.min(autopilot.wake_at()),
            Source::Crsf { .. } => alive,
        }
    }

    /// The messages of a step. The caller fills in the heads.
    pub fn measure(&mut self) -> (Imu, Odometry) {
        self.telemetry.measure()
    }

    /// True when an attitude has arrived since the last measurement.
    pub fn has_attitude(&self) -> bool {
        self.telemetry.is_fresh(Group::Attitude)
    }

    /// Bytes to send on a port; the caller clears them.
    pub fn output(&mut self, port: Port) -> &mut Vec<u8> {
        &mut self.out[port as usize]
    }

    /// The oldest note for the user.
    pub fn note(&mut self) -> Option<Note> {
        self.notes.take()
    }

    /// Mode: the source that drives the outputs.
    pub fn mode(&self) -> Mode {
        self.arming.mode()
    }

    /// The channels last sent, us, and which are in use.
    pub fn channels(&self) -> (&[f64; CHANNELS], &[bool; CHANNELS]) {
        (self.mapping.us(), self.mapping.in_use())
    }

    /// True when the vehicle reports that it is armed.
    pub fn is_armed(&self) -> bool {
        matches!(&self.source, Source::Mavlink(a) if a.is_armed())
    }

    /// Moves one channel, from 0, off its neutral while no source is in charge and the vehicle is disarmed,
    /// to check that it arrives; limits and rates apply.
    pub fn push(&mut self, channel: usize, by_us: f64, now: Duration) {
        if self.arming.mode() == Mode::Disarmed && !self.is_armed() {
            self.mapping.push(Some((channel, by_us)));
            self.send(now);
            self.mapping.push(None);
        }
    }

    /// Hands the channels over to the vehicle's own radio while no source is in charge, so that its sticks
    /// can be observed, or takes them back.
    pub fn lend(&mut self, lent: bool, now: Duration) {
        self.lent = lent && self.arming.mode() == Mode::Disarmed;
        self.send(now);
    }

    /// The channels with inputs that rotate the vehicle, and a sentence for every channel.
    pub fn steering(&self, inputs: &[Input]) -> (Vec<Steering>, Vec<String>) {
        (self.mapping.steering(inputs), self.mapping.sentences(inputs))
    }

    /// Channels that the vehicle reports to receive, us, unless the report is older than `age`.
    pub fn sent_channels(&self, age: Duration, now: Duration) -> Option<Vec<f64>> {
        match &self.source {
            Source::Mavlink(a) => a.sent_channels(age, now),
            Source::Crsf { .. } => None,
        }
    }

    /// The newest measurements.
    pub fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }
}
