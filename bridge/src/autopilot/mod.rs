//! Autopilots that fly the bench's vehicle: sensors out, actuator outputs in.
//!
//! Each protocol is an [`Autopilot`]: a state machine that receives datagrams or stream bytes with their time
//! of arrival, and returns bytes to send. It owns no socket and no clock.
//!
//! | | [`px4`] | [`ardupilot`] | [`betaflight`] |
//! |---|---|---|---|
//! | carried by | MAVLink over TCP, UDP or serial | datagrams | datagrams |
//! | who waits | the autopilot, in lockstep | the autopilot | nobody |
//! | says whether it is armed | yes | beside the loop | beside the loop |

pub mod ardupilot;
pub mod betaflight;
mod config;
mod flight;
mod heard;
pub mod px4;
mod rc;
mod simulator;

use std::time::Duration;

use crate::mixer::MAX_OUTPUTS;
use crate::note::Note;
use crate::sensors::Sensors;

pub use config::{AutopilotConfig, AutopilotKind, Parts};
pub use flight::{Begin, FlightOptions};
pub use rc::{RC_CHANNELS, Rc, RcOptions, Stage};

/// Sends data: arguments are the port, and one datagram or the next bytes of a stream.
pub type Send<'s> = dyn FnMut(usize, &[u8]) + 's;

/// Actuator outputs of an autopilot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outputs {
    /// Value of each output: 0 to 1 for a motor, -1 to 1 for a servo; zero for outputs that the autopilot
    /// does not have, NaN for one that it leaves undefined.
    pub values: [f64; MAX_OUTPUTS],
    /// Bit mask of outputs beyond their range, which are held at their limit; bit 0 is the first output.
    pub beyond: u32,
    /// True when the autopilot is armed; `None` when the protocol does not report it.
    pub armed: Option<bool>,
}

/// Event from an autopilot.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "outputs are the common case and live on the stack for a moment"
)]
pub enum Event {
    /// New actuator outputs.
    Outputs(Outputs),
    /// The autopilot restarted and lost its state.
    Restarted,
}

/// Counts of exchanged packets. Every packet that is discarded is counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Packets sent.
    pub sent: u64,
    /// Packets of actuator outputs that were used.
    pub outputs: u64,
    /// Packets that were repeated because an answer was lost; they are answered again.
    pub repeated: u64,
    /// Packets or bytes that violate the protocol: length, magic number, checksum, impossible value.
    pub malformed: u64,
    /// Packets that were overtaken, delayed, or replayed.
    pub stale: u64,
    /// Packets that never arrived, from gaps in their numbers.
    pub lost: u64,
    /// Sensor packets that were left out because the autopilot had not requested them.
    pub skipped: u64,
    /// Messages of a ground station that belong to the loop, and were not forwarded.
    pub refused: u64,
    /// Messages of a ground station for which the line had no room.
    pub unforwarded: u64,
}

impl Counts {
    /// Number of received packets that were discarded.
    pub fn dropped(&self) -> u64 {
        self.malformed + self.stale + self.refused + self.unforwarded
    }
}

/// The protocol of one autopilot.
pub trait Autopilot {
    /// True when a datagram received through `port` from an unknown sender is, by itself, valid in this
    /// protocol.
    fn recognises(&mut self, port: usize, datagram: &[u8], now: Duration) -> bool;

    /// Decodes a datagram, or the next bytes of a stream, received through `port`; may answer at once.
    /// Returns whether something in it was valid: not damaged, and not older than earlier data.
    fn receive(&mut self, port: usize, bytes: &[u8], now: Duration, send: &mut Send<'_>) -> bool;

    /// Marks the last data of `port` as a complete datagram, which no later bytes continue.
    fn end_of_datagram(&mut self, _port: usize) {}

    /// The next event from the received bytes; `None` until more bytes arrive.
    fn next(&mut self) -> Option<Event>;

    /// Sends the sensors of a step, and the pilot's channels.
    fn sense(&mut self, sensors: &Sensors, rc: &Rc, now: Duration, send: &mut Send<'_>);

    /// Last text from the autopilot on why it is not armed.
    fn said(&self) -> Option<&str> {
        None
    }

    /// Advice where to find the reason why it is not armed, when it has not reported it.
    fn advice(&self) -> String;

    /// The oldest note for the user.
    fn note(&mut self) -> Option<Note> {
        None
    }

    /// True when the outputs in response to the last sensors have arrived.
    fn is_answered(&self) -> bool;

    /// True when the autopilot waits for its sensors (lockstep), so that its answer can be waited for.
    fn is_lockstep(&self) -> bool;

    /// Resets the protocol after the link through `port` was lost.
    fn disconnected(&mut self, port: usize);

    /// Counts of packets exchanged so far.
    fn counts(&self) -> Counts;
}
