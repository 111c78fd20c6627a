//! PX4's simulation interface: MAVLink HIL messages.
//!
//! The simulator listens on TCP 4560 plus the instance, and PX4 connects; hardware in the loop does the same over a
//! serial line or UDP. HIL_SENSOR advances PX4's clock, and in lockstep PX4 answers it with HIL_ACTUATOR_CONTROLS of
//! the same time. HIL_GPS, HIL_STATE_QUATERNION (for PX4's log of the truth) and RC_CHANNELS go along.
//!
//! Source: <https://docs.px4.io/main/en/simulation/#simulator-mavlink-api>,
//! <https://mavlink.io/en/messages/common.html>.

mod messages;

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{Autopilot, Counts, Event, Outputs, Rc, Send};
use crate::mavlink::dialect::{HilActuatorControlsFlags, MavAutopilot, MavCmd, MavModeFlag};
use crate::mavlink::{Deframer, Encoder, Header, MavMessage, status_text};
use crate::mixer::MAX_OUTPUTS;
use crate::peer::Pin;
use crate::sensors::Sensors;

/// The TCP port of PX4's first instance.
pub const PORT: u16 = 4560;

/// Output of each motor of a quad in the order of the mixer's frames, which is PX4's own.
pub const NATIVE_ORDER: [usize; 4] = [1, 2, 3, 4];

/// The system that a simulator speaks as.
const SYSTEM: u8 = 142;
/// The component that a simulator speaks as.
const COMPONENT: u8 = 142;
/// Message number of HIL_STATE_QUATERNION.
const STATE_QUATERNION: f32 = 115.0;

/// Outputs go from -1 to 1; a little room for rounding.
const LARGEST_CONTROL: f64 = 1.001;

/// Time between two messages of a kind.
const MAG_PERIOD_NS: u64 = 10_000_000;
const BARO_PERIOD_NS: u64 = 20_000_000;
const CHANNEL_PERIOD_NS: u64 = 20_000_000;
const HEARTBEAT_PERIOD_NS: u64 = 1_000_000_000;
/// Until PX4 asks for another one.
const STATE_PERIOD_NS: u64 = 5_000_000;

/// Options of the link to PX4.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Px4Options {
    /// Where PX4 is: `tcpin://ADDRESS:PORT` where PX4 connects, or `serial://DEVICE:BAUD` or `udpin://ADDRESS:PORT` for
    /// hardware.
    pub link: String,
    /// The only address that is believed on `udpin` and `tcpin`; absent: the first that speaks validly.
    pub peer: Option<Pin>,
    /// Send the pitot's differential pressure.
    pub airspeed: bool,
    /// Send the pilot's channels; without them PX4 listens to its ground station alone.
    pub rc: bool,
}

impl Default for Px4Options {
    fn default() -> Self {
        Self { link: format!("tcpin://127.0.0.1:{PORT}"), peer: None, airspeed: false, rc: false }
    }
}

/// A board that reboots says nothing for longer, ...
const REBOOT: Duration = Duration::from_millis(500);

/// ... and its clock goes back by more, us.
const REBOOT_US: u64 = 1_000_000;

/// When a message is due again.
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

/// The conversation with PX4.
pub struct Px4 {
    options: Px4Options,
    motors: bool,
    deframer: Deframer,
    encoder: Encoder,
    /// Whether PX4 says that it waits for its sensors.
    lockstep: bool,
    /// Time of the last HIL_SENSOR, us.
    sensed: Option<u64>,
    /// The outputs of that time are here; without lockstep any that came after it.
    answered: bool,
    /// Time of the last HIL_ACTUATOR_CONTROLS, us, and when it came.
    controlled: Option<(u64, Duration)>,
    state_period_ns: u64,
    mag: Due,
    baro: Due,
    channels: Due,
    state: Due,
    heartbeat: Due,
    event: Option<Event>,
    /// What PX4 said last in words, over a line on which it speaks to its ground station as well.
    said: Option<String>,
    counts: Counts,
    /// What past connections exchanged.
    past: Counts,
    out: Vec<u8>,
}

impl Px4 {
    /// A conversation that has not begun; `motors` says that outputs are motors and not servos.
    pub fn new(options: Px4Options, motors: bool) -> Self {
        Self {
            options,
            motors,
            deframer: Deframer::new(),
            encoder: Encoder::new(SYSTEM, COMPONENT),
            lockstep: false,
            sensed: None,
            answered: true,
            controlled: None,
            state_period_ns: STATE_PERIOD_NS,
            mag: Due::default(),
            baro: Due::default(),
            channels: Due::default(),
            state: Due::default(),
            heartbeat: Due::default(),
            event: None,
            said: None,
            counts: Counts::default(),
            past: Counts::default(),
            out: Vec::new(),
        }
    }

    /// Takes outputs in; returns whether they count.
    fn controls(
        &mut self,
        controls: &crate::mavlink::dialect::HIL_ACTUATOR_CONTROLS_DATA,
        now: Duration,
    ) -> bool {
        // In lockstep the clock is ours, so that outputs of a time that was never sensed cannot be meant for us.
        let lockstep =
            controls.flags.contains(HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP);
        if lockstep && self.sensed.is_none_or(|sensed| controls.time_usec > sensed) {
            self.counts.malformed += 1;
            return false;
        }
        let armed = controls.mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
        // A board that rebooted was silent, has a young clock and is not armed. What is played again after a silence is.
        let rebooted = |(last, at): (u64, Duration)| {
            !armed && now.saturating_sub(at) > REBOOT && last.saturating_sub(controls.time_usec) > REBOOT_US
        };
        if self.controlled.is_some_and(rebooted) {
            self.controlled = None;
            self.event = Some(Event::Restarted);
            return true;
        }
        // A time that does not go on is that of an autopilot that stands still, or of a message that was played again.
        if self.controlled.is_some_and(|(last, _)| controls.time_usec <= last) {
            self.counts.stale += 1;
            return false;
        }
        let range = if self.motors { 0.0..=1.0 } else { -1.0..=1.0 };
        let (mut values, mut beyond) = ([0.0; MAX_OUTPUTS], 0);
        for (i, (value, &control)) in values.iter_mut().zip(&controls.controls).enumerate() {
            let control = f64::from(control);
            // PX4 leaves outputs that it does not use undefined.
            *value = if control.is_finite() { control.clamp(*range.start(), *range.end()) } else { f64::NAN };
            beyond |= u32::from(control.is_finite() && control.abs() > LARGEST_CONTROL) << i;
        }
        self.lockstep = lockstep;
        self.controlled = Some((controls.time_usec, now));
        self.answered |= !lockstep || self.sensed.is_some_and(|sensed| controls.time_usec >= sensed);
        self.counts.outputs += 1;
        self.event = Some(Event::Outputs(Outputs { values, beyond, armed: Some(armed) }));
        true
    }

    /// Takes a message in; returns whether it counts.
    fn take(&mut self, message: &MavMessage, now: Duration) -> bool {
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
            MavMessage::STATUSTEXT(m) => {
                if let Some((_, text)) = status_text(m) {
                    self.said = Some(text);
                }
            }
            _ => {}
        }
        true
    }
}

impl Autopilot for Px4 {
    fn recognises(&mut self, _port: usize, datagram: &[u8], now: Duration) -> bool {
        let is_autopilots = |_: &Header, message: &MavMessage| match message {
            MavMessage::HEARTBEAT(beat) => beat.autopilot != MavAutopilot::MAV_AUTOPILOT_INVALID,
            message => matches!(message, MavMessage::HIL_ACTUATOR_CONTROLS(_)),
        };
        self.deframer.recognises(datagram, now, is_autopilots)
    }

    fn receive(&mut self, _port: usize, bytes: &[u8], now: Duration, _send: &mut Send<'_>) -> bool {
        self.deframer.push(bytes);
        let mut valid = false;
        while let Some(event) = self.deframer.next(now) {
            if let crate::mavlink::Event::Message(_, message) = event {
                valid |= self.take(&message, now);
            }
        }
        valid
    }

    fn end_of_datagram(&mut self) {
        // What is left of it is counted there.
        let _ = self.deframer.end();
    }

    fn next(&mut self) -> Option<Event> {
        self.event.take()
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
            put(&messages::heartbeat());
        }
        if sensors.gps_fresh {
            put(&messages::gps(sensors));
        }
        if self.options.rc && self.channels.take(ns, CHANNEL_PERIOD_NS) {
            put(&messages::channels(sensors, &rc.pulses()));
        }
        if self.state_period_ns != u64::MAX && self.state.take(ns, self.state_period_ns) {
            put(&messages::state(sensors));
        }
        // Last, because it makes PX4 run.
        let mag = self.mag.take(ns, MAG_PERIOD_NS);
        let baro = self.baro.take(ns, BARO_PERIOD_NS);
        put(&messages::sensor(sensors, mag, baro, baro && self.options.airspeed));
        self.counts.sent += messages;
        self.sensed = Some(messages::microseconds(ns));
        self.answered = false;
        send(0, &out);
        self.out = out;
    }

    fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    fn is_answered(&self) -> bool {
        self.answered
    }

    fn is_lockstep(&self) -> bool {
        self.lockstep
    }

    fn disconnected(&mut self, _port: usize) {
        *self = Self { past: self.counts(), ..Self::new(self.options.clone(), self.motors) };
    }

    fn counts(&self) -> Counts {
        let wire = self.deframer.counts();
        Counts {
            sent: self.past.sent + self.counts.sent,
            outputs: self.past.outputs + self.counts.outputs,
            malformed: self.past.malformed + self.counts.malformed + wire.dropped() + wire.noise_bytes,
            stale: self.past.stale + self.counts.stale,
            lost: self.past.lost + wire.lost,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
