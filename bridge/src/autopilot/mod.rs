//! Autopilots that fly the bench's vehicle: sensors out, actuator outputs in.
//!
//! Each protocol is an [`Autopilot`]: a state machine that takes datagrams or stream bytes with the time of their
//! arrival, and hands out bytes to send. It owns no socket and no clock.
//!
//! | | [`px4`] | [`ardupilot`] | [`betaflight`] |
//! |---|---|---|---|
//! | carried by | MAVLink over TCP, UDP or serial | datagrams | datagrams |
//! | who waits | the autopilot, in lockstep | the autopilot | nobody |
//! | says whether it is armed | yes | no | no |

pub mod ardupilot;
pub mod betaflight;
mod config;
mod flight;
pub mod px4;
mod rc;

use std::time::Duration;

use crate::mixer::MAX_OUTPUTS;
use crate::note::Note;
use crate::sensors::Sensors;

pub use config::{AutopilotConfig, AutopilotKind, Parts};
pub use flight::{Begin, FlightOptions};
pub use rc::{RC_CHANNELS, Rc, RcOptions, Stage};

/// Takes what is to be sent: the port, and the bytes of one datagram or the next bytes of a stream.
pub type Send<'s> = dyn FnMut(usize, &[u8]) + 's;

/// Actuator outputs of an autopilot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outputs {
    /// Each output: 0 to 1 for a motor, -1 to 1 for a servo. Outputs that the autopilot does not have are zero; one that
    /// it leaves undefined is not a number.
    pub values: [f64; MAX_OUTPUTS],
    /// One bit for each output, from bit 0, that was beyond its range and is held at its limit.
    pub beyond: u32,
    /// Whether the autopilot is armed, when the protocol says so.
    pub armed: Option<bool>,
}

/// What came from an autopilot.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "outputs are the common case and live on the stack for a moment"
)]
pub enum Event {
    /// New actuator outputs.
    Outputs(Outputs),
    /// The autopilot restarted and has lost its state.
    Restarted,
}

/// Counts of exchanged packets. Every packet that is discarded is counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Packets sent.
    pub sent: u64,
    /// Packets of actuator outputs that were used.
    pub outputs: u64,
    /// Packets that came again because an answer was lost on its way; answered again.
    pub repeated: u64,
    /// Packets or bytes that are not what the protocol says: length, magic number, checksum, impossible value.
    pub malformed: u64,
    /// Packets that were overtaken on their way, delayed, or played again.
    pub stale: u64,
    /// Packets that never came, from gaps in their numbers.
    pub lost: u64,
    /// Sensor packets that were left out because the autopilot had not asked for them.
    pub skipped: u64,
    /// Messages of a ground station that belong to the loop, and were not passed on.
    pub refused: u64,
}

impl Counts {
    /// Packets that came and were given up.
    pub fn dropped(&self) -> u64 {
        self.malformed + self.stale + self.refused
    }
}

/// The protocol of one autopilot.
pub trait Autopilot {
    /// Whether a datagram that came through `port` from somebody unknown is one of this protocol, by itself.
    fn recognises(&mut self, port: usize, datagram: &[u8], now: Duration) -> bool;

    /// Takes in a datagram, or the next bytes of a stream, that came through `port`; may answer at once. Returns whether
    /// something in it was valid: not damaged, and not older than what came before.
    fn receive(&mut self, port: usize, bytes: &[u8], now: Duration, send: &mut Send<'_>) -> bool;

    /// What was received last through `port` was a datagram: nothing goes on behind it.
    fn end_of_datagram(&mut self, _port: usize) {}

    /// The next event from the received bytes; `None` until more bytes come.
    fn next(&mut self) -> Option<Event>;

    /// Sends the sensors of a step, and the pilot's channels.
    fn sense(&mut self, sensors: &Sensors, rc: &Rc, now: Duration, send: &mut Send<'_>);

    /// What the autopilot said last in words.
    fn said(&self) -> Option<&str> {
        None
    }

    /// Where to look for why it is not armed, when it has not said it.
    fn advice(&self) -> String;

    /// The oldest note for the user.
    fn note(&mut self) -> Option<Note> {
        None
    }

    /// Whether the outputs that answer the last sensors are here.
    fn is_answered(&self) -> bool;

    /// Whether the autopilot waits for its sensors (lockstep), so that its answer can be waited for.
    fn is_lockstep(&self) -> bool;

    /// Resets the protocol after the link through `port` was lost.
    fn disconnected(&mut self, port: usize);

    /// Counts of packets exchanged so far.
    fn counts(&self) -> Counts;
}
