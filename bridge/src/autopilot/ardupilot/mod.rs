//! ArduPilot's JSON interface: servo pulses in, one line of JSON out.
//!
//! The simulator binds UDP 9002. ArduPilot sends a packet of servo pulses from any port, waits for the answer
//! with the state of the vehicle, computes one step and sends the next packet. So ArduPilot runs in lockstep
//! with the answers, and its clock follows their time stamps. A repeated packet number means that the answer
//! was lost, and is answered with the same line again. Numbers that restart mean that ArduPilot restarted.
//!
//! A MAVLink link beside it ([`TELEMETRY`]) says why ArduPilot does not arm.
//!
//! Source: <https://ardupilot.org/dev/docs/sitl-with-JSON.html>.

mod json;
mod options;
mod packet;
mod telemetry;

use std::time::Duration;

use super::{Autopilot, Counts, Event, Outputs, Rc, Send};
use crate::mixer::MAX_OUTPUTS;
use crate::note::{Note, Notes};
use crate::sensors::Sensors;

pub use options::{ArdupilotOptions, PORT};
pub use packet::{PacketError, ServoPacket};
pub use telemetry::TELEMETRY;
use telemetry::Telemetry;

/// Output of each motor of a quad in the order of the mixer's frames, which is ArduPilot's own order.
pub const NATIVE_ORDER: [usize; 4] = [1, 2, 3, 4];

/// Silence after which a packet with a smaller number means a restart; before it, the packet is an old one.
/// ArduPilot repeats an unanswered packet once a second and needs longer than this to start.
const SILENCE: Duration = Duration::from_millis(500);

/// State of the conversation with ArduPilot.
#[derive(Debug)]
pub struct Ardupilot {
    options: ArdupilotOptions,
    motors: bool,
    last: Option<Last>,
    /// True while the packet with the last number is unanswered.
    waiting: bool,
    /// The last answer, to be repeated when it was lost.
    answer: String,
    /// Number of answers since the last packet, by which the next packet number may increase at most.
    answers: u32,
    /// Sensor time at which ArduPilot started, as its clock starts at zero, ns.
    began_ns: Option<u64>,
    events: [Option<Event>; 2],
    counts: Counts,
    /// Its MAVLink link, if there is one.
    telemetry: Option<Telemetry>,
    notes: Notes,
}

#[derive(Debug, Clone, Copy)]
struct Last {
    number: u32,
    at: Duration,
}

impl Ardupilot {
    /// A new conversation; `motors` is true when outputs are motors and not servos.
    pub fn new(options: ArdupilotOptions, motors: bool) -> Self {
        Self {
            telemetry: options.telemetry_place().map(|_| Telemetry::new()),
            options,
            motors,
            last: None,
            waiting: false,
            answer: String::new(),
            answers: 0,
            began_ns: None,
            events: [None; 2],
            counts: Counts::default(),
            notes: Notes::default(),
        }
    }

    fn outputs(&self, packet: &ServoPacket) -> Outputs {
        let (low, high) = (f64::from(self.options.pwm_min), f64::from(self.options.pwm_max));
        let (mut values, mut beyond) = ([0.0; MAX_OUTPUTS], 0);
        for (i, (value, &pwm)) in values.iter_mut().zip(packet.pulses()).enumerate() {
            // A pulse of zero means an unused output.
            if pwm != 0 {
                let share = (f64::from(pwm) - low) / (high - low);
                *value =
                    if self.motors { share.clamp(0.0, 1.0) } else { (2.0 * share - 1.0).clamp(-1.0, 1.0) };
                beyond |= u32::from(!(0.0..=1.0).contains(&share)) << i;
            }
        }
        Outputs { values, beyond, armed: None }
    }

    fn take(&mut self, packet: &ServoPacket, now: Duration) {
        self.last = Some(Last { number: packet.number, at: now });
        self.waiting = true;
        self.answers = 0;
        self.counts.outputs += 1;
        self.events[1] = Some(Event::Outputs(self.outputs(packet)));
    }

    fn restart(&mut self) {
        self.began_ns = None;
        self.answer.clear();
        self.events = [Some(Event::Restarted), None];
    }
}

impl Autopilot for Ardupilot {
    fn recognises(&mut self, port: usize, datagram: &[u8], now: Duration) -> bool {
        match &mut self.telemetry {
            Some(telemetry) if port == TELEMETRY => telemetry.recognises(datagram, now),
            _ => ServoPacket::parse(datagram).is_ok(),
        }
    }

    fn receive(&mut self, port: usize, bytes: &[u8], now: Duration, send: &mut Send<'_>) -> bool {
        if let Some(telemetry) = self.telemetry.as_mut().filter(|_| port == TELEMETRY) {
            return telemetry.receive(bytes, now, &mut self.notes);
        }
        let Ok(packet) = ServoPacket::parse(bytes) else {
            self.counts.malformed += 1;
            return false;
        };
        let Some(last) = self.last else {
            self.take(&packet, now);
            return true;
        };
        match packet.number.checked_sub(last.number) {
            Some(0) => {
                self.counts.repeated += 1;
                self.last = Some(Last { at: now, ..last });
                if !self.waiting && !self.answer.is_empty() {
                    self.counts.sent += 1;
                    send(0, self.answer.as_bytes());
                }
            }
            // ArduPilot counts the answers received.
            Some(ahead) if ahead <= self.answers => {
                self.counts.lost += u64::from(ahead - 1);
                self.take(&packet, now);
            }
            Some(_) => {
                self.counts.malformed += 1;
                return false;
            }
            None if now.saturating_sub(last.at) >= SILENCE => {
                self.restart();
                self.take(&packet, now);
            }
            None => {
                self.counts.stale += 1;
                return false;
            }
        }
        true
    }

    fn end_of_datagram(&mut self, port: usize) {
        if let Some(telemetry) = self.telemetry.as_mut().filter(|_| port == TELEMETRY) {
            telemetry.end();
        }
    }

    fn next(&mut self) -> Option<Event> {
        self.events.iter_mut().find_map(Option::take)
    }

    fn sense(&mut self, sensors: &Sensors, _rc: &Rc, now: Duration, send: &mut Send<'_>) {
        if let Some(telemetry) = &mut self.telemetry {
            let mut out = Vec::new();
            telemetry.say(now, &mut out);
            if !out.is_empty() {
                send(TELEMETRY, &out);
            }
        }
        // Unrequested answers would advance ArduPilot beyond its outputs.
        if !self.waiting {
            self.counts.skipped += 1;
            return;
        }
        let began = *self.began_ns.get_or_insert(sensors.time_ns);
        json::line(sensors, sensors.time_ns.saturating_sub(began), &mut self.answer);
        self.waiting = false;
        self.answers += 1;
        self.counts.sent += 1;
        send(0, self.answer.as_bytes());
    }

    fn said(&self) -> Option<&str> {
        self.telemetry.as_ref().and_then(|telemetry| telemetry.heard.said())
    }

    fn advice(&self) -> String {
        let is_heard = self.telemetry.as_ref().is_some_and(|telemetry| telemetry.heard.vehicle().is_some());
        match self.options.telemetry_place() {
            Some(_) if is_heard => "it gives no reason against it: arm it from its ground station".into(),
            Some(place) => format!(
                "nothing is received from it at {place} (bridge.ardupilot.telemetry); its ground station says why (PreArm), and arms it"
            ),
            None => "its ground station says why (PreArm), and arms it; bridge.ardupilot.telemetry, an address of its \
                     MAVLink, would say it here"
                .into(),
        }
    }

    fn note(&mut self) -> Option<Note> {
        self.notes.take()
    }

    fn is_answered(&self) -> bool {
        self.waiting
    }

    fn is_lockstep(&self) -> bool {
        true
    }

    fn disconnected(&mut self, port: usize) {
        if let Some(telemetry) = self.telemetry.as_mut().filter(|_| port == TELEMETRY) {
            return telemetry.end();
        }
        let (telemetry, notes) = (self.telemetry.take(), std::mem::take(&mut self.notes));
        let anew = Self::new(self.options.clone(), self.motors);
        *self = Self { counts: self.counts, telemetry, notes, ..anew };
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

#[cfg(test)]
mod tests;
