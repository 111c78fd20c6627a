//! A real vehicle in the plant's place: measurements in, channels out, and the gate between controller and wire.
//!
//! [`Vehicle`] is fed with bytes, commands and the time, and gives back bytes for its ports, measurements for the
//! bus and notes for the user. Whatever comes in, what goes out is within limits and rates, and moves away from
//! neutral only while [`Mode::Automatic`] or [`Mode::Manual`] holds.

mod autopilot;
mod clock;
mod note;
mod output;
mod requests;
mod telemetry;

use std::time::Duration;

use whirlstand_msgs::{Imu, Odometry};

use crate::arming::{ArmBy, Arming, Conditions, Mode, Policy};
use crate::channels::{CHANNELS, Mapping};
use crate::config::{
    BridgeConfig, BridgeKind, ConfigError, MavlinkConfig, OnFailure, Output, PilotSource, SafetyConfig,
};
use crate::crsf;
use crate::mavlink::{Deframer, Event, MavMessage, Signing};
use crate::pilot::Pilot;
use crate::sbus;
use crate::watch::EstimateWatch;
use autopilot::{Autopilot, Heard};
pub use note::Note;
use note::Notes;
pub use telemetry::{FIELDS, Group, Refusals, Telemetry};

/// Between two outputs that repeat the last, where no command comes.
const KEEP_ALIVE: Duration = Duration::from_millis(50);

/// A pause that no frame of SBUS has.
const SBUS_PAUSE: Duration = Duration::from_millis(3);

/// Where bytes come from and go to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Port {
    /// The vehicle.
    Link = 0,
    /// The channels, where they have a line of their own.
    Output = 1,
    /// The pilot's receiver.
    Pilot = 2,
    /// The ground station that listens.
    Ground = 3,
}

/// What the bench says of itself.
#[derive(Debug, Clone)]
pub struct Bench {
    /// Names of the inputs, in the vehicle's order.
    pub inputs: Vec<String>,
    /// Rate of the loop, Hz.
    pub rate_hz: f64,
    /// The vehicle file has positions or speeds.
    pub wants_odometry: bool,
    /// The secret of a signed link, and the Unix time at the origin of `now`.
    pub signing: Option<Signing>,
}

enum Source {
    Mavlink(Box<Autopilot>),
    Crsf {
        parser: crsf::Parser,
        quality: Option<u8>,
        linked_at: Option<Duration>,
        timeout: Duration,
        doubted: bool,
    },
}

/// Figures of a bridge.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Figures {
    /// Bytes that came from the vehicle.
    pub bytes: u64,
    /// Messages from the vehicle.
    pub messages: u64,
    /// Messages given up: damaged, unknown, unsigned.
    pub dropped: u64,
    /// Messages that never came, from gaps in their numbers.
    pub lost: u64,
    /// Measurements refused: repeated, overtaken, or not finite.
    pub refused: u64,
    /// Outputs sent.
    pub outputs: u64,
    /// Channel values that a limit or rate held back.
    pub clamped: u64,
    /// Offset of the vehicle's clock to ours, ns.
    pub clock_offset_ns: Option<i64>,
    /// Round trip of the exchange that the offset comes from, ns.
    pub round_trip_ns: Option<i64>,
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
    pilot: Option<Pilot>,
    pilot_source: Option<PilotSource>,
    pilot_crsf: crsf::Parser,
    pilot_sbus: sbus::Parser,
    pilot_bytes_at: Duration,
    ground: Deframer,
    refused_controls: u64,
    inputs: Vec<f64>,
    command_at: Option<Duration>,
    command_timeout: Duration,
    finite: bool,
    out: [Vec<u8>; 4],
    sent_at: Option<Duration>,
    least_interval: Duration,
    released: bool,
    outputs: u64,
    notes: Notes,
}

impl Vehicle {
    /// A vehicle that was not heard yet.
    ///
    /// # Errors
    /// [`ConfigError`] for options that cannot be.
    pub fn new(config: &BridgeConfig, bench: Bench) -> Result<Self, ConfigError> {
        let options = &config.options;
        let safety = options.safety.clone();
        check_safety(&safety, config)?;
        let pilot = options.pilot.as_ref().map(Pilot::new).transpose()?;
        let pilot_source = options.pilot.as_ref().map(|p| p.source);
        let timeout = Duration::from_secs_f64(safety.link_timeout_s);
        let (source, output, rate, mavlink) = match config.kind {
            BridgeKind::Mavlink => {
                let own = options.mavlink.as_ref().ok_or_else(|| missing(config.kind))?;
                check_mavlink(own)?;
                let wants_rc = pilot_source == Some(PilotSource::Mavlink);
                let autopilot = Autopilot::new(
                    own,
                    bench.rate_hz,
                    bench.wants_odometry,
                    wants_rc,
                    timeout,
                    bench.signing,
                );
                (Source::Mavlink(Box::new(autopilot)), own.output, own.output_rate_hz, Some(own.clone()))
            }
            BridgeKind::Crsf => {
                let own = options.crsf.as_ref().ok_or_else(|| missing(config.kind))?;
                let parser = crsf::Parser::new();
                let source = Source::Crsf { parser, quality: None, linked_at: None, timeout, doubted: false };
                (source, Output::Crsf, own.output_rate_hz, None)
            }
            other => {
                let message = format!("the bridge {other} is not one to a vehicle");
                return Err(ConfigError::new(&[other.name()], message));
            }
        };
        if rate.is_some_and(|hz| !(hz > 0.0 && hz.is_finite())) {
            let message = "a rate above 0 is expected; leave it out for one output a command";
            return Err(ConfigError::new(&[config.kind.name(), "output_rate_hz"], message));
        }
        let policy = Policy {
            arm: safety.arm,
            stale: Duration::from_secs_f64(safety.stale_s),
            recover_after: safety.recover_after_s.map(Duration::from_secs_f64),
        };
        Ok(Self {
            telemetry: Telemetry::new(&options.measured)?,
            mapping: Mapping::new(&options.channels, &bench.inputs, pilot.is_some())?,
            arming: Arming::new(policy),
            watch: EstimateWatch::new(safety.max_innovation),
            command_timeout: Duration::from_secs_f64(safety.command_timeout_s),
            safety,
            output,
            mavlink,
            source,
            pilot,
            pilot_source,
            pilot_crsf: crsf::Parser::new(),
            pilot_sbus: sbus::Parser::new(),
            pilot_bytes_at: Duration::ZERO,
            ground: Deframer::new(),
            refused_controls: 0,
            inputs: vec![0.0; bench.inputs.len()],
            command_at: None,
            finite: true,
            out: Default::default(),
            sent_at: None,
            least_interval: rate.map_or(Duration::ZERO, |hz| Duration::from_secs_f64(1.0 / hz)),
            released: false,
            outputs: 0,
            notes: Notes::default(),
        })
    }

    /// Takes in bytes from a port; `end` says that no frame goes on behind them, as in a datagram. Returns whether a
    /// new attitude came.
    pub fn receive(&mut self, port: Port, bytes: &[u8], end: bool, now: Duration) -> bool {
        match port {
            Port::Link => self.receive_link(bytes, end, now),
            Port::Pilot => self.receive_pilot(bytes, now),
            Port::Ground => self.receive_ground(bytes, now),
            Port::Output => {}
        }
        let fresh = self.telemetry.is_fresh(Group::Attitude);
        if self.telemetry.take_restart() {
            self.notes.warn("the vehicle's clock went back: it restarted");
            if let Source::Mavlink(autopilot) = &mut self.source {
                autopilot.begin_anew();
            }
            if let Some(mode) = self.arming.restarted() {
                self.announce(mode);
            }
        }
        fresh
    }

    /// Takes in the sticks of a gamepad, us.
    pub fn stick(&mut self, us: &[f64], now: Duration) {
        if let Some(pilot) = &mut self.pilot {
            pilot.hear(us, false, now);
        }
    }

    /// A port was connected anew: what was half received is gone.
    pub fn connected(&mut self, port: Port) {
        match (port, &mut self.source) {
            (Port::Link, Source::Mavlink(autopilot)) => autopilot.begin_anew(),
            (Port::Link, Source::Crsf { parser, .. }) => parser.reset(),
            (Port::Pilot, _) => {
                self.pilot_crsf.reset();
                self.pilot_sbus.reset();
            }
            (Port::Output | Port::Ground, _) => {}
        }
    }

    /// Takes in a command that answers the newest measurement, and sends what comes of it.
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

    /// Takes in an estimate: states, normalised innovation squared and its degrees of freedom.
    pub fn estimate(&mut self, states: &[f64], nis: f64, dof: u32, now: Duration) {
        // While its commands are not obeyed the estimator expects what does not happen.
        let dof = if self.arming.mode() == Mode::Automatic { dof } else { 0 };
        self.watch.hear(states, nis, dof, now);
    }

    /// Whether something broke, and nobody has armed again.
    pub fn has_failed(&self) -> bool {
        matches!(self.arming.mode(), Mode::Failed(_))
    }

    /// The bench ends: nobody is in charge any more, and an override is taken back.
    pub fn end(&mut self, now: Duration) {
        if let Some(mode) = self.arming.end() {
            self.announce(mode);
        }
        self.mapping.reset();
        self.send(now);
        if let (Source::Mavlink(autopilot), Output::RcOverride) = (&mut self.source, self.output)
            && autopilot.is_known()
        {
            let message = output::rc_override(None, self.mapping.in_use(), autopilot.target());
            autopilot.send(&message, now, &mut self.out[Port::Link as usize]);
        }
    }

    /// Does what time alone asks for: notices silence, keeps the outputs alive, says heartbeats. To be called at
    /// least every [`Vehicle::wake_at`].
    pub fn poll(&mut self, now: Duration) {
        self.decide(now);
        if let Source::Mavlink(autopilot) = &mut self.source {
            autopilot.poll(now, &mut self.notes, &mut self.out[Port::Link as usize]);
        }
        if self.sent_at.is_none_or(|at| now.saturating_sub(at) >= KEEP_ALIVE) {
            self.send(now);
        }
    }

    /// When to call [`Vehicle::poll`] at the latest.
    pub fn wake_at(&self, now: Duration) -> Duration {
        let alive = self.sent_at.map_or(now, |at| at + KEEP_ALIVE);
        match &self.source {
            Source::Mavlink(autopilot) => alive.min(autopilot.wake_at()),
            Source::Crsf { .. } => alive,
        }
    }

    /// The messages of a step; heads are the caller's.
    pub fn measure(&mut self) -> (Imu, Odometry) {
        self.telemetry.measure()
    }

    /// Whether an attitude came since the last measurement.
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

    /// Who is in charge.
    pub fn mode(&self) -> Mode {
        self.arming.mode()
    }

    /// The channels as they were sent last, us, and which are in use.
    pub fn channels(&self) -> (&[f64; CHANNELS], &[bool; CHANNELS]) {
        (self.mapping.us(), self.mapping.in_use())
    }

    /// What was measured last.
    pub fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }

    /// Figures since the start.
    pub fn figures(&mut self) -> Figures {
        let refusals = self.telemetry.refusals();
        let mut figures = Figures {
            refused: refusals.not_finite + refusals.old + self.refused_controls,
            outputs: self.outputs,
            clamped: self.mapping.clamped(),
            ..Figures::default()
        };
        match &self.source {
            Source::Mavlink(autopilot) => {
                let c = autopilot.counts();
                (figures.bytes, figures.messages, figures.lost) = (c.bytes, c.messages, c.lost);
                figures.dropped = c.dropped();
            }
            Source::Crsf { parser, .. } => {
                let c = parser.counts();
                (figures.bytes, figures.messages) = (c.bytes, c.frames);
                figures.dropped = c.checksum + c.malformed;
            }
        }
        if let Some((offset, trip)) = self.telemetry.clock().offset() {
            (figures.clock_offset_ns, figures.round_trip_ns) = (Some(offset), trip);
        }
        figures
    }

    /// A ground station may ask and set, but not steer: what moves the vehicle passes the gate of the bridge alone.
    fn receive_ground(&mut self, bytes: &[u8], now: Duration) {
        self.ground.push(bytes);
        while let Some(event) = self.ground.next(now) {
            match event {
                Event::Message(_, message) if steers(&message) => {
                    self.refused_controls += 1;
                    if self.refused_controls == 1 {
                        self.notes.warn("the ground station tried to steer: only this bridge does");
                    }
                }
                Event::Message(..) => {
                    self.out[Port::Link as usize].extend_from_slice(self.ground.frame());
                }
                Event::Dropped(_) => {}
            }
        }
        let _ = self.ground.end();
    }

    fn receive_link(&mut self, bytes: &[u8], end: bool, now: Duration) {
        match &mut self.source {
            Source::Mavlink(autopilot) => {
                let pilot = match self.pilot_source {
                    Some(PilotSource::Mavlink) => self.pilot.as_mut(),
                    _ => None,
                };
                let reply = &mut self.out[Port::Link as usize];
                let mut heard =
                    Heard { telemetry: &mut self.telemetry, pilot, notes: &mut self.notes, reply };
                autopilot.receive(bytes, end, now, &mut heard);
            }
            Source::Crsf { parser, quality, linked_at, doubted, .. } => {
                parser.push(bytes);
                while let Some(event) = parser.next_event() {
                    match event {
                        crsf::Event::Attitude(a) => {
                            let angles = [a.roll, a.pitch, a.yaw];
                            let _ = self.telemetry.take(Group::Attitude, angles, None, now);
                            *linked_at = Some(now);
                        }
                        crsf::Event::LinkStatistics(link) => {
                            *quality = Some(link.uplink_quality);
                            *linked_at = Some(now);
                        }
                        crsf::Event::Battery(b) if b.remaining_percent == 0 => {
                            self.notes.warn(format!("the battery is empty: {:.1} V", b.voltage_v));
                        }
                        _ => {}
                    }
                }
                let counts = parser.counts();
                if !*doubted && counts.frames == 0 && counts.bytes > 300 {
                    *doubted = true;
                    self.notes.warn(format!(
                        "{} bytes came in, and none of them is CRSF: is the baud rate right (416666 or 420000)?",
                        counts.bytes
                    ));
                }
            }
        }
    }

    fn receive_pilot(&mut self, bytes: &[u8], now: Duration) {
        let Some(pilot) = &mut self.pilot else { return };
        if now.saturating_sub(self.pilot_bytes_at) > SBUS_PAUSE {
            self.pilot_sbus.reset();
        }
        self.pilot_bytes_at = now;
        match self.pilot_source {
            Some(PilotSource::Sbus) => {
                self.pilot_sbus.push(bytes);
                while let Some(frame) = self.pilot_sbus.next_frame() {
                    pilot.hear(&frame.channels.map(sbus::us_of_ticks), frame.failsafe, now);
                }
            }
            Some(PilotSource::Crsf) => {
                self.pilot_crsf.push(bytes);
                while let Some(event) = self.pilot_crsf.next_event() {
                    if let crsf::Event::Channels(c) = event {
                        pilot.hear(&c.0.map(crsf::us_of_ticks), false, now);
                    }
                }
            }
            _ => {}
        }
    }

    fn conditions(&self, now: Duration) -> Conditions {
        let (link, well, armed) = match &self.source {
            Source::Mavlink(a) => (a.is_linked(now), a.is_well(), a.is_armed()),
            Source::Crsf { quality, linked_at, timeout, .. } => {
                let heard = linked_at.is_some_and(|at| now.saturating_sub(at) <= *timeout);
                (heard && *quality != Some(0), true, false)
            }
        };
        let arm = match self.safety.arm {
            ArmBy::Switch => self.pilot.as_ref().is_some_and(Pilot::arm),
            ArmBy::Autopilot => armed,
            ArmBy::Start => true,
        };
        Conditions {
            arm,
            link,
            data_age: self.telemetry.age(Group::Attitude, now),
            vehicle_well: well,
            commands: self.command_at.is_some_and(|at| now.saturating_sub(at) <= self.command_timeout),
            finite: self.finite,
            estimate: self.watch.is_good(),
            pilot: self.pilot.as_ref().map(|p| p.view(now)),
        }
    }

    fn decide(&mut self, now: Duration) {
        let conditions = self.conditions(now);
        if let Some(mode) = self.arming.update(&conditions, now) {
            if mode == Mode::Automatic {
                self.watch.reset();
            }
            self.announce(mode);
            self.send(now);
        }
    }

    fn announce(&mut self, mode: Mode) {
        match mode {
            Mode::Automatic => self.notes.info("armed: the controller is in charge"),
            Mode::Manual => self.notes.info("the pilot is in charge"),
            Mode::Disarmed => self.notes.info("disarmed: outputs at neutral"),
            Mode::Failed(reason) => {
                let what = match self.safety.on_failure {
                    OnFailure::Neutral => "outputs at neutral",
                    OnFailure::Release => "outputs handed over",
                };
                self.notes.warn(format!("FAILSAFE, {what}: {reason}"));
            }
        }
    }

    /// Whether the vehicle's own pilot or failsafe has the vehicle, and nothing is to be sent.
    fn is_handed_over(&self) -> bool {
        match self.arming.mode() {
            Mode::Failed(_) => self.safety.on_failure == OnFailure::Release,
            // The stick of a pilot who flies by the vehicle's own radio needs no relay.
            Mode::Manual => self.pilot_source == Some(PilotSource::Mavlink),
            Mode::Disarmed | Mode::Automatic => false,
        }
    }

    fn send(&mut self, now: Duration) {
        self.sent_at = Some(now);
        let released = self.is_handed_over();
        if released {
            self.mapping.reset();
        } else {
            self.mapping.apply(self.arming.mode(), &self.inputs, self.pilot.as_ref(), now);
        }
        let first_release = released && !std::mem::replace(&mut self.released, released);
        let (us, in_use) = (self.mapping.us(), self.mapping.in_use());
        if let (Source::Mavlink(autopilot), Some(config)) = (&mut self.source, &self.mavlink) {
            let target = autopilot.target();
            let message = match self.output {
                // An override is taken back again and again: the first message may be lost.
                Output::RcOverride => Some(output::rc_override((!released).then_some(us), in_use, target)),
                _ if released => None,
                Output::ManualControl => Some(output::manual_control(us, in_use, target.0)),
                Output::AttitudeTarget => {
                    let yaw = self.telemetry.values(Group::Attitude).map_or(0.0, |[_, _, yaw]| yaw);
                    Some(output::attitude_target(us, in_use, &config.attitude_target, yaw, target, now))
                }
                Output::Crsf | Output::Sbus => None,
            };
            if let Some(message) = message.filter(|_| autopilot.is_known()) {
                autopilot.send(&message, now, &mut self.out[Port::Link as usize]);
                self.outputs += 1;
            }
        }
        self.released = released;
        if released {
            if first_release {
                self.notes.info("the outputs are handed over");
            }
            return;
        }
        let crsf_port = if matches!(self.source, Source::Crsf { .. }) { Port::Link } else { Port::Output };
        match self.output {
            Output::Crsf => output::crsf(us, &mut self.out[crsf_port as usize]),
            Output::Sbus => output::sbus(us, &mut self.out[Port::Output as usize]),
            _ => return,
        }
        self.outputs += 1;
    }
}

/// Whether a message moves the vehicle.
fn steers(message: &MavMessage) -> bool {
    matches!(
        message,
        MavMessage::RC_CHANNELS_OVERRIDE(_)
            | MavMessage::MANUAL_CONTROL(_)
            | MavMessage::SET_ATTITUDE_TARGET(_)
            | MavMessage::SET_POSITION_TARGET_LOCAL_NED(_)
            | MavMessage::SET_POSITION_TARGET_GLOBAL_INT(_)
            | MavMessage::SET_ACTUATOR_CONTROL_TARGET(_)
    )
}

fn missing(kind: BridgeKind) -> ConfigError {
    let message = format!("the table [bridge.{kind}] with the key 'link' is missing: add it");
    ConfigError::new(&[kind.name()], message)
}

fn check_safety(safety: &SafetyConfig, config: &BridgeConfig) -> Result<(), ConfigError> {
    let fail = |key: &str, message: &str| Err(ConfigError::new(&["safety", key], message));
    for (key, value) in [
        ("stale_s", Some(safety.stale_s)),
        ("command_timeout_s", Some(safety.command_timeout_s)),
        ("link_timeout_s", Some(safety.link_timeout_s)),
        ("recover_after_s", safety.recover_after_s),
    ] {
        if value.is_some_and(|v| !(v > 0.0 && v <= 60.0)) {
            return fail(key, "a time above 0 and up to 60 s is expected");
        }
    }
    if safety.max_innovation.is_nan() || safety.max_innovation <= 1.0 {
        return fail("max_innovation", "a number above 1 is expected: a filter promises 1");
    }
    match safety.arm {
        ArmBy::Switch if config.options.pilot.is_none() => fail(
            "arm",
            "arm = \"switch\" needs the pilot's stick: add [bridge.pilot], or say arm = \"autopilot\" or \"start\"",
        ),
        ArmBy::Autopilot if config.kind != BridgeKind::Mavlink => fail(
            "arm",
            "only a MAVLink autopilot tells whether it is armed: say arm = \"switch\" or \"start\"",
        ),
        ArmBy::Switch | ArmBy::Autopilot if safety.recover_after_s.is_some() => {
            fail("recover_after_s", "only with arm = \"start\": else whoever arms decides")
        }
        _ => Ok(()),
    }
}

fn check_mavlink(config: &MavlinkConfig) -> Result<(), ConfigError> {
    let fail = |key: &str, message: &str| Err(ConfigError::new(&["mavlink", key], message));
    let own_line = matches!(config.output, Output::Crsf | Output::Sbus);
    if own_line && config.output_link.is_none() {
        return fail("output_link", "the channels need a serial port: add the key 'output_link'");
    }
    if !own_line && config.output_link.is_some() {
        return fail("output_link", "only output = \"crsf\" and \"sbus\" have a line of their own");
    }
    if config.message_rate_hz.is_some_and(|hz| !(0.0..=4000.0).contains(&hz)) {
        return fail("message_rate_hz", "a rate from 0 to 4000 Hz is expected");
    }
    if config.system == 0 || config.component == 0 {
        return fail("system", "numbers from 1 on are expected: 0 means all");
    }
    if config.heading.is_some_and(|h| !h.is_finite()) {
        return fail("heading", "a finite angle in rad is expected");
    }
    if !(config.attitude_target.full.is_finite() && config.attitude_target.full_yaw_rate.is_finite()) {
        return fail("attitude_target", "finite numbers are expected");
    }
    Ok(())
}
