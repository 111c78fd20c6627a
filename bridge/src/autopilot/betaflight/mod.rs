//! Betaflight's software-in-the-loop interface: motor outputs in, vehicle state and pilot's channels out.
//!
//! Betaflight runs in real time beside the bench, without lockstep. Its clock runs at the ratio of packet
//! time to wall time between the last two state packets that it received (`updateState`, `micros64`): of two
//! packets waiting together the second is processed microseconds after the first, and its clock then runs
//! hundreds of times too fast until the next one. It loses its pilot and disarms, and its estimator turns too
//! far. Packets with equal times leave the rate at its initial value, one, and are used like any other. So
//! all packets have the same time, and none need be held back.
//!
//! | direction | port | packet |
//! |---|---|---|
//! | from Betaflight | 9001 | `servo_packet_raw`: u16 count, 2 unused, f32\[16\] pulses in us; motors, then servos |
//! | from Betaflight | 9002 | `servo_packet`: f32\[4\] motors, 0 to 1 |
//! | to Betaflight | 9003 | `fdm_packet`: 18 f64 |
//! | to Betaflight | 9004 | `rc_packet`: f64 time, u16\[16\] pulses in us |
//!
//! All are little-endian. The ports are compiled into Betaflight. Over TCP 5761 it is queried in the MultiWii
//! Serial Protocol for the reason why it is not armed.
//!
//! Source: `src/platform/SIMULATOR/target/SITL/target.h` and `sitl.c` of Betaflight 2025.12 (`src/main/target/SITL` of
//! older releases).

mod packet;

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{Autopilot, Counts, Event, Outputs, Rc, Send, Stage};
use crate::mixer::MAX_OUTPUTS;
use crate::msp::{Answer, ArmSwitch, ArmingFlags, Parser, RANGES_REQUEST, STATUS_REQUEST};
use crate::note::{Note, Notes};
use crate::peer::Pin;
use crate::sensors::Sensors;

pub use packet::{FDM_BYTES, Flavour, PacketError, RC_BYTES, parse_motors, parse_raw, raw_bytes};

/// Ports by index: packets of pulses, packets of motors, state, channels.
pub const PORTS: [u16; 4] = [9001, 9002, 9003, 9004];
/// Index of the port of `servo_packet_raw`.
pub const RAW: usize = 0;
/// Index of the port of `servo_packet`.
pub const MOTORS: usize = 1;
/// Index of the port for the state.
pub const STATE: usize = 2;
/// Index of the port for the channels.
pub const CHANNELS: usize = 3;

/// Index of the port for MSP queries.
pub const MSP: usize = 4;

/// Usual address of Betaflight's MSP port.
pub const MSP_PLACE: &str = "tcpout://127.0.0.1:5761";

/// Time between two queries for the reason why it is not armed.
const ASK: Duration = Duration::from_millis(500);

/// Smallest output of a running motor.
const TURNING: f64 = 0.005;

/// Betaflight's motor 1 is at the rear right, then front right, rear left, front left.
pub const NATIVE_ORDER: [usize; 4] = [2, 3, 4, 1];

/// Time between two packets of channels: a receiver's 50 Hz.
const CHANNEL_PERIOD: Duration = Duration::from_millis(20);

/// Silence after which Betaflight is not running, and gets no channels: it would discard those received
/// during its start and then have no receiver (`udpRCThread` makes them its receiver once, `rxInit` then sets
/// it to another).
const NOT_RUNNING: Duration = Duration::from_millis(500);

/// Packets from which the outputs are taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Packets {
    /// `servo_packet_raw`: motors and servos, in Betaflight's order in every release.
    #[default]
    Raw,
    /// `servo_packet`: four motors. Releases before 2025.12 send them in Gazebo's order, which is that of the
    /// mixer's frames: give the mixer `outputs = [1, 2, 3, 4]`.
    Motors,
}

/// Options of the link to Betaflight.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BetaflightOptions {
    /// Address of Betaflight's computer.
    pub host: String,
    /// Address of this computer on which Betaflight's packets arrive.
    pub bind: String,
    /// The only accepted sender; absent: the first one with a valid packet on each port.
    pub peer: Option<Pin>,
    /// The four ports compiled into Betaflight.
    pub ports: [u16; 4],
    /// Format in which Betaflight reads state packets.
    pub flavour: Flavour,
    /// Packets from which the outputs are taken.
    pub packets: Packets,
    /// Address of MSP queries for the reason why it is not armed; empty: none.
    pub msp: String,
}

impl Default for BetaflightOptions {
    fn default() -> Self {
        Self {
            host: "127.0.0.1".into(),
            bind: "127.0.0.1".into(),
            peer: None,
            ports: PORTS,
            flavour: Flavour::default(),
            packets: Packets::default(),
            msp: MSP_PLACE.into(),
        }
    }
}

/// State of the conversation with Betaflight.
#[derive(Debug, Clone)]
pub struct Betaflight {
    options: BetaflightOptions,
    motors: bool,
    origin: Option<(f64, f64)>,
    answered: bool,
    last_outputs: Option<Duration>,
    last_channels: Option<Duration>,
    event: Option<Event>,
    counts: Counts,
    answers: Parser,
    turns: bool,
    next_ask: Duration,
    /// Its arming flags, its arm switch, and the last reported reason why it is not armed.
    flags: ArmingFlags,
    switch: Option<ArmSwitch>,
    said: Option<String>,
    told: Option<String>,
    notes: Notes,
}

impl Betaflight {
    /// A new conversation; `motors` is true when outputs are motors and not servos.
    pub fn new(options: BetaflightOptions, motors: bool) -> Self {
        Self {
            options,
            motors,
            origin: None,
            answered: false,
            last_outputs: None,
            last_channels: None,
            event: None,
            counts: Counts::default(),
            answers: Parser::default(),
            turns: false,
            next_ask: Duration::ZERO,
            flags: ArmingFlags::default(),
            switch: None,
            said: None,
            told: None,
            notes: Notes::default(),
        }
    }

    /// Decodes answers; true if there was one.
    fn hear(&mut self, bytes: &[u8]) -> bool {
        self.answers.push(bytes);
        let mut valid = false;
        while let Some(answer) = self.answers.next_answer() {
            valid = true;
            match answer {
                Answer::Arming(flags) => self.flags = flags,
                Answer::Switch(switch) => self.switch = Some(switch),
                Answer::Attitude(_) => {}
            }
        }
        valid
    }

    /// Queries the reason while it is not armed, and reports it once its switch is on.
    fn ask(&mut self, rc: &Rc, now: Duration, send: &mut Send<'_>) {
        if self.turns || self.options.msp.is_empty() {
            return;
        }
        if now >= self.next_ask {
            self.next_ask = now + ASK;
            send(MSP, &STATUS_REQUEST);
            if self.switch.is_none() {
                send(MSP, &RANGES_REQUEST);
            }
            self.said = self.why_not(rc);
        }
        if matches!(rc.stage(), Stage::Arming | Stage::Flying) && self.told != self.said {
            if let Some(why) = &self.said {
                self.notes.warn(format!("Betaflight cannot be armed: {why}"));
            }
            self.told.clone_from(&self.said);
        }
    }

    /// Reason why it cannot be armed, according to its answers.
    fn why_not(&self, rc: &Rc) -> Option<String> {
        let (channel, pulse) = rc.switch();
        let switch = self.switch.and_then(|switch| switch.reason(channel, pulse));
        let reasons: Vec<_> = switch.into_iter().chain(self.flags.reason()).collect();
        (!reasons.is_empty()).then(|| reasons.join(", "))
    }

    fn outputs(&self, port: usize, bytes: &[u8]) -> Result<Outputs, PacketError> {
        let (mut values, mut beyond) = ([0.0; MAX_OUTPUTS], 0);
        if port == RAW {
            let pulses = parse_raw(bytes)?;
            for (i, (value, &pulse)) in values.iter_mut().zip(pulses.values()).enumerate() {
                beyond |= u32::from(pulse != 0.0 && !(1000.0..=2000.0).contains(&pulse)) << i;
                *value = match (pulse, self.motors) {
                    // A pulse of zero means an unused output.
                    (0.0, _) => 0.0,
                    (pulse, true) => ((pulse - 1000.0) / 1000.0).clamp(0.0, 1.0),
                    (pulse, false) => ((pulse - 1500.0) / 500.0).clamp(-1.0, 1.0),
                };
            }
        } else if port == MOTORS {
            values[..4].copy_from_slice(&parse_motors(bytes)?);
        } else {
            return Err(PacketError::Port);
        }
        Ok(Outputs { values, beyond, armed: None })
    }
}

impl Autopilot for Betaflight {
    fn recognises(&mut self, port: usize, datagram: &[u8], _now: Duration) -> bool {
        if port == MSP {
            let mut parser = Parser::default();
            parser.push(datagram);
            return parser.next_answer().is_some();
        }
        self.outputs(port, datagram).is_ok()
    }

    fn receive(&mut self, port: usize, bytes: &[u8], now: Duration, _send: &mut Send<'_>) -> bool {
        if port == MSP {
            return self.hear(bytes);
        }
        let Ok(outputs) = self.outputs(port, bytes) else {
            self.counts.malformed += 1;
            return false;
        };
        // The other packet contains the same outputs.
        if (port == RAW) == (self.options.packets == Packets::Raw) {
            self.counts.outputs += 1;
            self.answered = true;
            self.last_outputs = Some(now);
            self.turns = outputs.values[..4].iter().any(|v| *v > TURNING);
            self.event = Some(Event::Outputs(outputs));
        }
        true
    }

    fn next(&mut self) -> Option<Event> {
        self.event.take()
    }

    fn sense(&mut self, sensors: &Sensors, rc: &Rc, now: Duration, send: &mut Send<'_>) {
        let runs = self.last_outputs.is_some_and(|last| now.saturating_sub(last) < NOT_RUNNING);
        if runs && self.last_channels.is_none_or(|last| now.saturating_sub(last) >= CHANNEL_PERIOD) {
            self.last_channels = Some(now);
            self.counts.sent += 1;
            send(CHANNELS, &packet::channels(now, &rc.pulses()));
        }
        self.ask(rc, now, send);
        self.answered = false;
        self.counts.sent += 1;
        let origin = *self.origin.get_or_insert((sensors.gps.latitude, sensors.gps.longitude));
        send(STATE, &packet::state(sensors, self.options.flavour, origin));
    }

    fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    fn advice(&self) -> String {
        match self.options.msp.as_str() {
            "" => "bridge.betaflight.msp is where it would be asked; its configurator shows its arming flags"
                .into(),
            place => format!(
                "it is asked at {place} (bridge.betaflight.msp) once its switch is on, which bridge.rc.arm does after \
                 bridge.rc.grace_s"
            ),
        }
    }

    fn note(&mut self) -> Option<Note> {
        self.notes.take()
    }

    fn is_answered(&self) -> bool {
        self.answered
    }

    fn is_lockstep(&self) -> bool {
        false
    }

    fn disconnected(&mut self, port: usize) {
        if port == MSP {
            self.answers = Parser::default();
        } else {
            self.origin = None;
        }
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

#[cfg(test)]
mod tests;
