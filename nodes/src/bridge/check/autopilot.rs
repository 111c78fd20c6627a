//! Check of an autopilot.
//!
//! The simulated vehicle is first at rest, then it is tilted about each axis in both directions, and the
//! attitude that the autopilot reports over its telemetry must follow. So gyroscope, accelerometer and
//! magnetic field are checked through the autopilot's own estimator. The autopilot stays disarmed; with `arm`
//! its outputs must counteract the tilts as well.

mod manoeuvre;

use std::time::{Duration, Instant};

use whirlstand_bridge::attitude_receiver::{AttitudeReceiver, TelemetryProtocol};
use whirlstand_bridge::autopilot::px4::STATION;
use whirlstand_bridge::autopilot::{
    Autopilot, AutopilotConfig, AutopilotKind, Event, Outputs, Parts, Rc, Stage,
};
use whirlstand_bridge::config::BridgeConfig;
use whirlstand_bridge::mixer::{FrameKind, Mixer};
use whirlstand_bridge::sensors::{Errors, Motion, SensorModel};

use super::super::hil::constant::constant_sensors;
use super::super::hil::links::Links;
use super::super::hil::state::Flight;
use super::super::link::{Address, BUFFER, Link, wait_for_bytes};
use super::reaction::Demands;
use super::telemetry::Telemetry;
use super::tilt::AXES;
use super::{CheckOptions, Finding};
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::setup::Setup;

/// Largest age of a reported attitude.
const AGE: Duration = Duration::from_millis(500);

/// Time without any attitude after which the telemetry is connected again.
const SILENCE: Duration = Duration::from_secs(5);

/// Largest reported attitude of a level vehicle, rad.
const LEVEL: f64 = 0.1;

/// Usual telemetry endpoint and protocol of each autopilot.
fn usual_place(kind: AutopilotKind) -> (&'static str, TelemetryProtocol) {
    match kind {
        AutopilotKind::Px4Hil | AutopilotKind::ArdupilotJson => {
            ("udpin://0.0.0.0:14550", TelemetryProtocol::Mavlink)
        }
        AutopilotKind::BetaflightSitl => ("tcpout://127.0.0.1:5761", TelemetryProtocol::Msp),
    }
}

/// State of a check.
struct Check<'a> {
    name: &'static str,
    autopilot: Box<dyn Autopilot>,
    links: Links,
    attitude_receiver: AttitudeReceiver,
    /// Telemetry link of the autopilot's attitude, unless it uses its only link.
    telemetry: Option<Link>,
    model: SensorModel,
    mixer: Mixer,
    rc: Rc,
    flight: Flight,
    newest: Option<Outputs>,
    demands: Demands,
    period: Duration,
    patience: Duration,
    origin: Instant,
    due: Instant,
    sensed_at: Instant,
    /// Time of the simulated sensors.
    sensor_time: Duration,
    /// Longest time between two readings of a free-running autopilot's sensors since it was last set to zero.
    pause: Duration,
    /// True when there were no fresh outputs, and none of an armed autopilot, since this was last set to false.
    silent: bool,
    disarmed: bool,
    say: &'a mut dyn FnMut(Finding),
}

/// Checks the bridge to an autopilot; `say` receives each finding when it is made.
///
/// # Errors
/// For invalid options, and an autopilot that does not answer.
pub fn check_autopilot(
    config: &NodeConfig,
    bridge: &BridgeConfig,
    options: &CheckOptions,
    say: &mut dyn FnMut(Finding),
) -> Result<(), NodeError> {
    let wrong =
        |field: String, value: &str, reason: String| NodeError::Config { field, value: value.into(), reason };
    let Some(mut autopilot) = AutopilotConfig::of(bridge) else {
        let reason = "it takes the place of a vehicle, not of an autopilot".into();
        return Err(wrong("bridge".into(), bridge.kind.name(), reason));
    };
    autopilot.rc.arm = options.arm;
    // The check itself is the only client of these ports.
    autopilot.betaflight.msp.clear();
    autopilot.px4.telemetry = Some(String::new());
    autopilot.ardupilot.telemetry = Some(String::new());
    let name = autopilot.kind.autopilot();
    let setup = Setup::new(config)?;
    let Parts { mixer, rc, .. } = autopilot
        .parts(&setup.vehicle, false, 1e9 / config.period_ns as f64)
        .map_err(|e| wrong(format!("bridge.{}", e.path.join(".")), name, e.message))?;
    let (usual, protocol) = usual_place(autopilot.kind);
    let mut links = Links::new(&autopilot)?;
    let shares = autopilot.kind == AutopilotKind::Px4Hil && options.telemetry.is_none();
    let only = links.shared_serial().filter(|_| shares).map(ToString::to_string);
    let place = only.as_deref().or(options.telemetry.as_deref()).unwrap_or(usual);
    let apart = only.is_none().then(|| place.parse::<Address>()).transpose();
    let telemetry = apart.map_err(|e| wrong("--telemetry".into(), place, format!("{e}")))?.map(Link::new);
    if telemetry.is_none() {
        links.overhear();
    }
    let now = Instant::now();
    let mut check = Check {
        name,
        links,
        attitude_receiver: AttitudeReceiver::new(protocol),
        telemetry,
        model: SensorModel::new(autopilot.sensors.clone(), config.period_ns, config.seed),
        rc,
        flight: Flight::new(&autopilot.flight, autopilot.mixer.frame),
        mixer,
        newest: None,
        demands: Demands::default(),
        period: Duration::from_nanos(config.period_ns),
        patience: Duration::from_secs_f64(autopilot.flight.answer_timeout_s),
        autopilot: autopilot.autopilot(config.period_ns),
        origin: now,
        due: now,
        sensed_at: now,
        sensor_time: Duration::ZERO,
        pause: Duration::ZERO,
        silent: false,
        disarmed: false,
        say,
    };
    if let Some(text) = constant_sensors(autopilot.kind, &check.model, Errors::default) {
        (check.say)(Finding::Told(text));
    }
    check.run(options, place, autopilot.mixer.frame != FrameKind::Ccpm)
}

impl Check<'_> {
    /// Makes the findings one after another; motors show whether the autopilot is armed.
    ///
    /// # Errors
    /// No outputs arrive.
    fn run(&mut self, options: &CheckOptions, place: &str, has_motors: bool) -> Result<(), NodeError> {
        self.wait_for_outputs(options)?;
        if self.flight.is_flying(&self.mixer, self.now()) {
            (self.say)(Finding::Wrong(format!("{} is armed: disarm it, then check again", self.name)));
            return Ok(());
        }
        self.link();
        let leveled = self.wait_for_level(options, place);
        if options.arm && !has_motors {
            let text = "the outputs: a swashplate moves whether armed or not, so arming shows nothing";
            (self.say)(Finding::Unknown(text.into()));
        }
        let armed = options.arm && has_motors && self.arm(options);
        for axis in 0..AXES.len() {
            if (leveled || armed) && !self.axis(axis, leveled, armed, options.timeout) {
                break;
            }
        }
        self.disarm();
        Ok(())
    }

    fn now(&self) -> Duration {
        self.origin.elapsed()
    }

    fn attitude(&self) -> Option<[f64; 3]> {
        self.attitude_receiver.attitude(AGE, self.now())
    }

    /// Keeps the vehicle level for at most `limit`, until `done` returns a result.
    fn until<T>(&mut self, limit: Duration, mut done: impl FnMut(&mut Self) -> Option<T>) -> Option<T> {
        let begun = Instant::now();
        while begun.elapsed() < limit {
            self.turn(&|_| Motion::default());
            if let Some(found) = done(self) {
                return Some(found);
            }
        }
        None
    }

    /// Moves the vehicle along `motion`, over the time of the sensors.
    fn fly(&mut self, span: Duration, motion: impl Fn(Duration) -> Motion) {
        let begun = self.sensor_time;
        while self.sensor_time < begun + span {
            self.turn(&|at| motion(at - begun));
        }
    }

    /// Waits for bytes or the next sensor reading; receives the former and sends the latter.
    fn turn(&mut self, motion: &dyn Fn(Duration) -> Motion) {
        self.wait();
        let now = self.now();
        self.links.receive(self.autopilot.as_mut(), now);
        while let Some(event) = self.autopilot.next() {
            match event {
                Event::Outputs(outputs) => {
                    self.flight.take(outputs, now);
                    self.demands.add(&self.mixer, &outputs.values);
                    self.newest = Some(outputs);
                }
                Event::Restarted => (self.say)(Finding::Wrong(format!("{} began anew", self.name))),
            }
        }
        if let Some(why) = self.links.take_lost() {
            (self.say)(Finding::Wrong(why));
        }
        self.receive(now);
        self.silent |= !self.flight.is_fresh(now);
        self.disarmed |= !self.flight.is_flying(&self.mixer, now);
        let instant = Instant::now();
        if instant < self.due() {
            return;
        }
        if self.autopilot.is_lockstep() {
            // The sensors of an autopilot in lockstep advance by one period, whatever the wall time.
            self.due = instant + self.period;
            return self.sense(1, motion, now);
        }
        // A free-running autopilot uses wall time: a late reading covers all periods since the last one.
        let late = instant.saturating_duration_since(self.due).as_nanos() / self.period.as_nanos();
        let periods = u32::try_from(late).unwrap_or(u32::MAX).saturating_add(1);
        self.due += self.period * periods;
        self.pause = self.pause.max(self.period * periods);
        self.sense(periods, motion, now);
    }

    /// Time of the next sensor message: for an autopilot in lockstep after its answer, or when the answer
    /// seems lost.
    fn due(&self) -> Instant {
        let waits = self.autopilot.is_lockstep() && !self.autopilot.is_answered();
        if waits { self.due.max(self.sensed_at + self.patience) } else { self.due }
    }

    fn sense(&mut self, periods: u32, motion: &dyn Fn(Duration) -> Motion, now: Duration) {
        self.sensor_time += self.period * periods;
        self.sensed_at = Instant::now();
        self.rc.turn(self.flight.is_fresh(now), true, now);
        let motion = motion(self.sensor_time);
        let sensors = self.model.step_after(periods.into(), &motion, &Errors::default());
        let links = &mut self.links;
        self.autopilot.sense(&sensors, &self.rc, now, &mut |port, bytes| links.send(port, bytes));
    }

    fn wait(&self) {
        // Both outcomes lead to another poll.
        let telemetry = self.telemetry.as_ref().and_then(Link::fd);
        wait_for_bytes(self.links.fds().chain(telemetry), self.due(), Duration::ZERO);
    }

    /// Receives the autopilot's telemetry.
    fn receive(&mut self, now: Duration) {
        match &mut self.telemetry {
            Some(telemetry) => {
                // A missing telemetry link is retried; its absence is reported by the missing attitude.
                let _ = telemetry.maintain(Instant::now());
                let mut protocol = Telemetry { receiver: &mut self.attitude_receiver, now };
                let _ = telemetry.drain(&mut [0; BUFFER], Instant::now(), &mut protocol);
            }
            None => {
                let heard = self.links.take_overheard();
                self.attitude_receiver.receive(&heard, now);
            }
        }
        let mut ask = Vec::new();
        self.attitude_receiver.ask(now, &mut ask);
        let links = &mut self.links;
        match &self.telemetry {
            _ if ask.is_empty() => {}
            Some(telemetry) => {
                telemetry.sender().send(&ask);
            }
            None => {
                self.autopilot.receive(STATION, &ask, now, &mut |port, bytes| links.send(port, bytes));
            }
        }
    }

    fn wait_for_outputs(&mut self, options: &CheckOptions) -> Result<(), NodeError> {
        let came = self.until(options.timeout, |check| check.newest.map(drop));
        came.ok_or(NodeError::NoAutopilot {
            name: self.name,
            waited_s: options.timeout.as_secs_f64(),
            malformed: self.autopilot.counts().malformed + self.links.refused().invalid,
        })
    }

    /// Checks rate and losses.
    fn link(&mut self) {
        let (before, begun) = (self.autopilot.counts(), Instant::now());
        let _: Option<()> = self.until(Duration::from_secs(1), |_| None);
        let (after, spent) = (self.autopilot.counts(), begun.elapsed().as_secs_f64());
        let outputs = ((after.outputs - before.outputs) as f64 / spent).round();
        let (dropped, lost) = (after.dropped() - before.dropped(), after.lost - before.lost);
        let text =
            format!("{} sends outputs {outputs} times a second; {dropped} damaged, {lost} lost", self.name);
        (self.say)(if outputs > 0.0 && dropped + lost == 0 {
            Finding::Good(text)
        } else {
            Finding::Wrong(text)
        });
    }

    /// Waits until the autopilot reports a level attitude; false when it reports none.
    fn wait_for_level(&mut self, options: &CheckOptions, place: &str) -> bool {
        let level = |a: &[f64; 3]| a[0].abs() < LEVEL && a[1].abs() < LEVEL;
        let end = Instant::now() + options.timeout;
        let mut settled = None;
        while settled.is_none() && Instant::now() < end {
            let left = end.saturating_duration_since(Instant::now());
            settled = self.until(SILENCE.min(left), |check| check.attitude().filter(level));
            // A program that is still starting may accept a connection and never answer it: another one is made.
            if self.attitude().is_none()
                && let Some(telemetry) = &mut self.telemetry
            {
                *telemetry = Link::new(telemetry.address().clone());
            }
        }
        let name = self.name;
        match settled.map_or_else(|| self.attitude().ok_or(()), Ok) {
            Ok(angles) => {
                let [roll, pitch, _] = angles.map(|a| format!("{:+.1}", a.to_degrees()));
                let text =
                    format!("the vehicle stands level, and {name} says roll {roll}, pitch {pitch} deg");
                (self.say)(if level(&angles) { Finding::Good(text) } else { Finding::Wrong(text) });
                true
            }
            Err(()) => {
                (self.say)(Finding::Unknown(format!(
                    "the sensors: {name} does not report its attitude at {place}; give its place with --telemetry, or start {name} again"
                )));
                false
            }
        }
    }

    /// Arms, or waits for somebody to arm; false when the autopilot was not armed.
    fn arm(&mut self, options: &CheckOptions) -> bool {
        if self.rc.stage() == Stage::Off {
            (self.say)(Finding::Ask(format!("now arm {} with its ground station", self.name)));
        } else {
            (self.say)(Finding::Ask(format!("arming {} by its pilot's channels", self.name)));
        }
        let armed = self.wait_for_arming(options.timeout);
        if !armed {
            (self.say)(Finding::Unknown(format!("the outputs: {} was not armed in time", self.name)));
        }
        armed
    }

    /// Waits until the autopilot is armed and the throttle up; false when it is not in time.
    fn wait_for_arming(&mut self, limit: Duration) -> bool {
        let armed = |check: &mut Self| {
            let up = matches!(check.rc.stage(), Stage::Off | Stage::Flying);
            (up && check.flight.is_flying(&check.mixer, check.now())).then_some(())
        };
        self.until(limit, armed).is_some()
    }

    /// Disarms the autopilot through its pilot's channels.
    fn disarm(&mut self) {
        if self.rc.stage() != Stage::Off {
            self.rc.turn(false, false, self.now());
            self.flight.forget();
            let _: Option<()> = self.until(Duration::from_millis(200), |_| None);
        }
    }
}
