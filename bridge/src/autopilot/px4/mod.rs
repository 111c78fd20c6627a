//! PX4's simulation interface: MAVLink HIL messages.
//!
//! The simulator listens on TCP 4560 plus the instance, and PX4 connects; hardware in the loop does the same over a
//! serial line or UDP. HIL_SENSOR advances PX4's clock, and in lockstep PX4 answers it with HIL_ACTUATOR_CONTROLS of
//! the same time. HIL_GPS, HIL_STATE_QUATERNION (for PX4's log of the truth) and RC_CHANNELS go along.
//!
//! A board speaks to a ground station over the same line, which has its own port here ([`STATION`]). Software in the
//! loop has separate links, of which one is received ([`TELEMETRY`]). Both contain the reasons why it does not arm.
//! Source: <https://docs.px4.io/main/en/simulation/#simulator-mavlink-api>,
//! <https://mavlink.io/en/messages/common.html>.

mod beside;
mod messages;
mod options;
mod station;

use std::time::Duration;

use super::heard::Heard;
use super::simulator::{self, COMPONENT, SYSTEM, is_vehicles_beat};
use super::{Autopilot, Counts, Event, Outputs, Rc, Send};
use crate::forward::Forward;
use crate::mavlink::dialect::{HilActuatorControlsFlags, MavCmd, MavModeFlag};
use crate::mavlink::{Deframer, DropReason, Encoder, Header, MavMessage};
use crate::mixer::MAX_OUTPUTS;
use crate::note::{Note, Notes};
use crate::sensors::Sensors;
use options::{CHANNEL_PERIOD_NS, STATE_PERIOD_NS};
pub use options::{PORT, Px4Options};
use station::{Owned, Station, is_for_station};

/// Port of the ground station; the link to PX4 is port 0.
pub const STATION: usize = 1;

/// Port for telemetry of a PX4 that does not report its state to its simulator.
pub const TELEMETRY: usize = 2;

/// Output of each motor of a quad in the order of the mixer's frames, which is PX4's own order.
pub const NATIVE_ORDER: [usize; 4] = [1, 2, 3, 4];

/// Message number of HIL_STATE_QUATERNION.
const STATE_QUATERNION: f32 = 115.0;

/// Largest magnitude of an output, with a margin for rounding.
const LARGEST_CONTROL: f64 = 1.001;

/// Time between two messages of a kind.
const MAG_PERIOD_NS: u64 = 10_000_000;
const BARO_PERIOD_NS: u64 = 20_000_000;
const HEARTBEAT_PERIOD_NS: u64 = 1_000_000_000;
/// Time between two requests for the summary of the arming checks, which PX4 reports only when it changes.
const CHECKS_PERIOD_NS: u64 = 4_000_000_000;

/// Shortest silence of a board that reboots.
const REBOOT: Duration = Duration::from_millis(500);

/// Smallest step back of the clock of a board that reboots, us.
const REBOOT_US: u64 = 1_000_000;

/// Time at which a message is due again.
#[derive(Debug, Clone, Copy, Default)]
struct Due(u64);

impl Due {
    fn take(&mut self, now_ns: u64, period_ns: u64) -> bool {
        let due = now_ns >= self.0;
        if due {
            self.0 = if now_ns >= self.0 + period_ns { now_ns + period_ns } else { self.0 + period_ns };
        }
        due
    }
}

/// State of the conversation with PX4.
pub struct Px4 {
    options: Px4Options,
    motors: bool,
    deframer: Deframer,
    telemetry: Deframer,
    encoder: Encoder,
    /// True when PX4 reports that it waits for its sensors.
    lockstep: bool,
    /// Time of the last HIL_SENSOR, us.
    sensed: Option<u64>,
    /// True when the outputs for that time have arrived; without lockstep any later ones.
    answered: bool,
    /// Time of the last HIL_ACTUATOR_CONTROLS, us, and its time of arrival.
    controlled: Option<(u64, Duration)>,
    state_period_ns: u64,
    /// Shortest period of the true state on the line, ns.
    least_state_period_ns: u64,
    mag: Due,
    baro: Due,
    channels: Due,
    state: Due,
    heartbeat: Due,
    ask_checks: Due,
    /// A restart, and the newest outputs since: several messages may be read at once.
    events: [Option<Event>; 2],
    /// Messages of PX4 to all, on a line on which it speaks to its ground station as well.
    heard: Heard,
    station: Station,
    notes: Notes,
    counts: Counts,
    /// Counts of earlier connections.
    past: Counts,
    out: Vec<u8>,
}

impl Px4 {
    /// A new conversation; `motors` is true when outputs are motors and not servos.
    pub fn new(options: Px4Options, motors: bool) -> Self {
        Self::with_state_period(options, motors, STATE_PERIOD_NS)
    }

    /// A conversation on a line that allows the true state no more often than this, ns.
    pub(in crate::autopilot) fn with_state_period(
        options: Px4Options,
        motors: bool,
        least_state_period_ns: u64,
    ) -> Self {
        let station = Station::new(Forward::new(&options.link, Duration::ZERO));
        Self {
            options,
            motors,
            deframer: Deframer::new(),
            telemetry: Deframer::new(),
            encoder: Encoder::new(SYSTEM, COMPONENT),
            lockstep: false,
            sensed: None,
            answered: true,
            controlled: None,
            state_period_ns: STATE_PERIOD_NS,
            least_state_period_ns,
            mag: Due::default(),
            baro: Due::default(),
            channels: Due::default(),
            state: Due::default(),
            heartbeat: Due::default(),
            ask_checks: Due::default(),
            events: [None; 2],
            heard: Heard::new("PX4"),
            station,
            notes: Notes::default(),
            counts: Counts::default(),
            past: Counts::default(),
            out: Vec::new(),
        }
    }

    /// Processes outputs; returns whether they count.
    fn controls(
        &mut self,
        controls: &crate::mavlink::dialect::HIL_ACTUATOR_CONTROLS_DATA,
        now: Duration,
    ) -> bool {
        // In lockstep the clock is ours: outputs for a time without sensors are not for us.
        let lockstep =
            controls.flags.contains(HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP);
        if lockstep && self.sensed.is_none_or(|sensed| controls.time_usec > sensed) {
            self.counts.malformed += 1;
            return false;
        }
        let armed = controls.mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        // A rebooted board was silent, has a young clock and is not armed; a replayed flight after a silence
        // is armed.
        let rebooted = |(last, at): (u64, Duration)| {
            !armed && now.saturating_sub(at) > REBOOT && last.saturating_sub(controls.time_usec) > REBOOT_US
        };
        if self.controlled.is_some_and(rebooted) {
            self.controlled = None;
            self.events = [Some(Event::Restarted), None];
            return true;
        }
        // A time that does not advance is that of a stopped autopilot, or of a replayed message.
        if self.controlled.is_some_and(|(last, _)| controls.time_usec <= last) {
            self.counts.stale += 1;
            return false;
        }
        let range = if self.motors { 0.0..=1.0 } else { -1.0..=1.0 };
        let (mut values, mut beyond) = ([0.0; MAX_OUTPUTS], 0);
        for (i, (value, &control)) in values.iter_mut().zip(&controls.controls).enumerate() {
            let control = f64::from(control);
            // PX4 leaves unused outputs undefined.
            *value = if control.is_finite() { control.clamp(*range.start(), *range.end()) } else { f64::NAN };
            beyond |= u32::from(control.is_finite() && control.abs() > LARGEST_CONTROL) << i;
        }
        self.lockstep = lockstep;
        self.controlled = Some((controls.time_usec, now));
        self.answered |= !lockstep || self.sensed.is_some_and(|sensed| controls.time_usec >= sensed);
        self.counts.outputs += 1;
        self.events[1] = Some(Event::Outputs(Outputs { values, beyond, armed: Some(armed) }));
        true
    }

    /// Processes a message; returns whether it counts.
    fn take(&mut self, header: Header, message: &MavMessage, now: Duration) -> bool {
        match message {
            MavMessage::HIL_ACTUATOR_CONTROLS(controls) => return self.controls(controls, now),
            MavMessage::COMMAND_LONG(command)
                if command.command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL
                    && command.param1 == STATE_QUATERNION =>
            {
                // Interval in us; 0 for the default, -1 for never.
                self.state_period_ns = match command.param2 {
                    us if us >= 1.0 => (f64::from(us) * 1e3) as u64,
                    us if us < 0.0 => u64::MAX,
                    _ => STATE_PERIOD_NS,
                };
            }
            message => self.heard.hear(0, header, message, &mut self.notes),
        }
        true
    }
}

impl Autopilot for Px4 {
    fn recognises(&mut self, port: usize, datagram: &[u8], now: Duration) -> bool {
        if port == STATION {
            return self.station.recognises(datagram, now);
        }
        if port == TELEMETRY {
            return self.telemetry.recognises(datagram, now, |_, message| is_vehicles_beat(message));
        }
        let is_autopilots = |_: &Header, message: &MavMessage| match message {
            MavMessage::HIL_ACTUATOR_CONTROLS(_) => true,
            message => is_vehicles_beat(message),
        };
        self.deframer.recognises(datagram, now, is_autopilots)
    }

    fn receive(&mut self, port: usize, bytes: &[u8], now: Duration, send: &mut Send<'_>) -> bool {
        if port == STATION {
            let vehicle = self.heard.vehicle().map(|header| (header.system, header.component));
            let owned = Owned { vehicle, channels: self.options.rc };
            let valid = self.station.receive(bytes, now, owned, &mut self.notes);
            self.forward(now, send);
            return valid;
        }
        if port == TELEMETRY {
            return self.listen(bytes, now);
        }
        self.deframer.push(bytes);
        let mut valid = false;
        while let Some(event) = self.deframer.next(now) {
            match event {
                crate::mavlink::Event::Message(header, message) => {
                    if is_for_station(&message) {
                        send(STATION, self.deframer.frame());
                    }
                    valid |= self.take(header, &message, now);
                }
                // A message of another dialect means nothing to the loop, but possibly to the station. A
                // single byte is no message.
                crate::mavlink::Event::Dropped(DropReason::Unknown(_)) if self.deframer.frame().len() > 1 => {
                    send(STATION, self.deframer.frame());
                }
                crate::mavlink::Event::Dropped(_) => {}
            }
        }
        self.forward(now, send);
        valid
    }

    fn end_of_datagram(&mut self, port: usize) {
        let ended = match port {
            STATION => return self.station.end(),
            TELEMETRY => &mut self.telemetry,
            _ => &mut self.deframer,
        };
        // The remainder is counted there.
        let _ = ended.end();
    }

    fn next(&mut self) -> Option<Event> {
        self.events.iter_mut().find_map(Option::take)
    }

    fn sense(&mut self, sensors: &Sensors, rc: &Rc, now: Duration, send: &mut Send<'_>) {
        let ns = sensors.time_ns;
        let mut out = std::mem::take(&mut self.out);
        out.clear();
        let mut messages = 0;
        let mut put = |message: &MavMessage| {
            messages += 1;
            self.encoder.encode(message, now, &mut out);
        };
        if self.heartbeat.take(ns, HEARTBEAT_PERIOD_NS) {
            put(&simulator::heartbeat());
        }
        if sensors.gps_fresh {
            put(&messages::gps(sensors));
        }
        if self.options.rc && self.channels.take(ns, CHANNEL_PERIOD_NS) {
            put(&messages::channels(sensors, &rc.pulses()));
        }
        let asks = self.heard.vehicle().filter(|_| !self.heard.is_armed());
        let asks = asks.filter(|_| self.ask_checks.take(ns, CHECKS_PERIOD_NS)).zip(self.heard.answers_at());
        if let Some((vehicle, 0)) = asks {
            put(&simulator::ask_for_arming_checks(vehicle));
        }
        let state_period_ns = self.state_period_ns.max(self.least_state_period_ns);
        if state_period_ns != u64::MAX && self.state.take(ns, state_period_ns) {
            put(&messages::state(sensors));
        }
        // Sent last, because it advances PX4.
        let mag = self.mag.take(ns, MAG_PERIOD_NS);
        let baro = self.baro.take(ns, BARO_PERIOD_NS);
        put(&messages::sensor(sensors, mag, baro, baro && self.options.airspeed));
        self.counts.sent += messages;
        self.sensed = Some(messages::microseconds(ns));
        self.answered = false;
        send(0, &out);
        self.station.waiting.sent(out.len(), true, now);
        if let Some((vehicle, port @ TELEMETRY)) = asks {
            out.clear();
            self.encoder.encode(&simulator::ask_for_arming_checks(vehicle), now, &mut out);
            send(port, &out);
        }
        self.out = out;
        self.forward(now, send);
    }

    fn said(&self) -> Option<&str> {
        self.heard.said()
    }

    fn advice(&self) -> String {
        let place = self.options.telemetry_place().filter(|_| self.heard.answers_at() != Some(TELEMETRY));
        match place {
            Some(place) => format!(
                "nothing is received from it at {place} (bridge.px4.telemetry); its console says why (commander check), and its \
                 ground station"
            ),
            None => "it gives no reason against it: arm it from its ground station".into(),
        }
    }

    fn note(&mut self) -> Option<Note> {
        self.notes.take()
    }

    fn is_answered(&self) -> bool {
        self.answered
    }

    fn is_lockstep(&self) -> bool {
        self.lockstep
    }

    fn disconnected(&mut self, port: usize) {
        match port {
            STATION => return self.station.end(),
            TELEMETRY => {
                let _ = self.telemetry.end();
                return;
            }
            _ => {}
        }
        let anew = Self::with_state_period(self.options.clone(), self.motors, self.least_state_period_ns);
        let station = std::mem::replace(&mut self.station, anew.station);
        let (past, notes) = (self.past_counts(), std::mem::take(&mut self.notes));
        *self = Self { past, station, notes, ..anew };
        self.station.waiting.clear();
    }

    fn counts(&self) -> Counts {
        let (refused, unforwarded) = (self.station.refused(), self.station.waiting.dropped());
        Counts { refused, unforwarded, ..self.past_counts() }
    }
}

#[cfg(test)]
mod station_tests;
#[cfg(test)]
mod tests;
