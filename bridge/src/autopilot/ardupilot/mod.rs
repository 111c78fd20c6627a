//! ArduPilot's JSON interface: servo pulses in, one line of JSON out.
//!
//! The simulator binds UDP 9002. ArduPilot sends a packet of servo pulses from any port, waits for the answer
//! with the state of the vehicle, computes one step and sends the next packet. So ArduPilot runs in lockstep
//! with the answers, and its clock follows their time stamps. A repeated packet number means that the answer
//! was lost, and is answered with the same line again. Numbers that restart mean that ArduPilot restarted.
//!
//! Source: <https://ardupilot.org/dev/docs/sitl-with-JSON.html>.

mod json;
mod packet;

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{Autopilot, Counts, Event, Outputs, Rc, Send};
use crate::mixer::MAX_OUTPUTS;
use crate::peer::Pin;
use crate::sensors::Sensors;

pub use packet::{PacketError, ServoPacket};

/// The UDP port that ArduPilot sends to.
pub const PORT: u16 = 9002;

/// Output of each motor of a quad in the order of the mixer's frames, which is ArduPilot's own order.
pub const NATIVE_ORDER: [usize; 4] = [1, 2, 3, 4];

/// Silence after which a packet with a smaller number means a restart; before it, the packet is an old one.
/// ArduPilot repeats an unanswered packet once a second and needs longer than this to start.
const SILENCE: Duration = Duration::from_millis(500);

/// Options of the link to ArduPilot, with the range of its pulses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArdupilotOptions {
    /// Address on which ArduPilot's packets arrive, `udpin://ADDRESS:PORT`; they are answered to their
    /// sender.
    pub link: String,
    /// The only accepted sender; absent: the first one with a valid packet.
    pub peer: Option<Pin>,
    /// Pulse of a motor at rest, or of a servo at -1, us.
    pub pwm_min: u16,
    /// Pulse of a motor at full thrust, or of a servo at 1, us.
    pub pwm_max: u16,
}

impl Default for ArdupilotOptions {
    fn default() -> Self {
        Self { link: format!("udpin://127.0.0.1:{PORT}"), peer: None, pwm_min: 1000, pwm_max: 2000 }
    }
}

/// State of the conversation with ArduPilot.
#[derive(Debug, Clone)]
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
            options,
            motors,
            last: None,
            waiting: false,
            answer: String::new(),
            answers: 0,
            began_ns: None,
            events: [None; 2],
            counts: Counts::default(),
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
    fn recognises(&mut self, _port: usize, datagram: &[u8], _now: Duration) -> bool {
        ServoPacket::parse(datagram).is_ok()
    }

    fn receive(&mut self, _port: usize, bytes: &[u8], now: Duration, send: &mut Send<'_>) -> bool {
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

    fn next(&mut self) -> Option<Event> {
        self.events.iter_mut().find_map(Option::take)
    }

    fn sense(&mut self, sensors: &Sensors, _rc: &Rc, _now: Duration, send: &mut Send<'_>) {
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

    fn advice(&self) -> String {
        "its ground station says why (PreArm), and arms it".into()
    }

    fn is_answered(&self) -> bool {
        self.waiting
    }

    fn is_lockstep(&self) -> bool {
        true
    }

    fn disconnected(&mut self, _port: usize) {
        *self = Self { counts: self.counts, ..Self::new(self.options.clone(), self.motors) };
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}

#[cfg(test)]
mod tests;
