//! Relay to a controller over a UDP socket: every `Estimate` is sent as one datagram, every received datagram
//! is a `Command`.
//!
//! A datagram contains the same as over Zenoh: the schema hash, then the message in postcard.

use std::io::ErrorKind;
use std::net::UdpSocket;
use std::os::fd::AsFd;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use whirlstand_bus::Bus;
use whirlstand_msgs::{Command, Estimate, Message, decode, encode};

use super::{Answers, DEPTH};
use crate::error::NodeError;
use crate::os::{StopFlag, notify_ready};
use crate::ports::receive;

/// Time for which only the socket is watched for the answer to an estimate; then the bus is watched as well,
/// with a poll of the socket once per millisecond.
const ANSWER: Timespec = Timespec { tv_sec: 0, tv_nsec: 2_000_000 };

/// Period of checks whether the end was requested.
const LOOK: Duration = Duration::from_millis(100);

/// Upper bound of a message's size, bytes.
const LARGEST: usize = 2048;

struct Relay<'a> {
    socket: &'a UdpSocket,
    answers: Answers,
    buffer: [u8; LARGEST],
    /// Number of datagrams that were no valid command.
    refused: u64,
}

/// Relays until the end is requested. The socket is connected to the controller, so that the system refuses
/// datagrams of others.
///
/// # Errors
/// [`NodeError`] when the bus or the socket fails. A controller that is not there yet is no error.
pub fn run_udp(bus: &Bus, socket: &UdpSocket, stop: &StopFlag) -> Result<(), NodeError> {
    let system = |action| move |source| NodeError::System { action, source };
    socket.set_nonblocking(true).map_err(system("prepare the UDP socket"))?;
    let mut estimates = bus.subscriber::<Estimate>(DEPTH)?;
    let mut relay = Relay { socket, answers: Answers::open(bus)?, buffer: [0; LARGEST], refused: 0 };
    notify_ready(bus.locators()).map_err(system("tell the launcher that the relay is ready"))?;
    let (mut wire, mut damaged) = (Vec::with_capacity(LARGEST), 0);
    while !stop.is_set() {
        let mut next = None;
        bus.wait_until(Instant::now() + LOOK, || {
            relay.take_answers()?;
            next = receive(&mut estimates, &mut damaged)?;
            Ok::<_, NodeError>(next.is_some() || stop.is_set())
        })?;
        let Some(estimate) = next else { continue };
        // An estimate is repeated when its answer was lost or late: the first answer is final.
        if let Some(command) = relay.answers.of(estimate.head.step) {
            relay.answers.send(&command)?;
            continue;
        }
        encode(&estimate, &mut wire);
        match socket.send(&wire) {
            Ok(_) => {}
            Err(e) if is_passing(e.kind()) => continue,
            Err(source) => return Err(NodeError::System { action: "send to the controller", source }),
        }
        // Errors of the system recur at the next read of the socket.
        let _ = poll(&mut [PollFd::new(&socket.as_fd(), PollFlags::IN)], Some(&ANSWER));
        relay.take_answers()?;
    }
    Ok(())
}

impl Relay<'_> {
    fn take_answers(&mut self) -> Result<(), NodeError> {
        loop {
            let length = match self.socket.recv(&mut self.buffer) {
                Ok(length) => length,
                // The other end is not listening yet.
                Err(e) if e.kind() == ErrorKind::ConnectionRefused => continue,
                Err(e) if is_passing(e.kind()) => return Ok(()),
                Err(source) => {
                    return Err(NodeError::System { action: "receive from the controller", source });
                }
            };
            match decode::<Command>(&self.buffer[..length]) {
                Ok(command) => self.answers.send(&command)?,
                Err(e) => {
                    if self.refused == 0 {
                        tracing::warn!("the controller sent no {}: {e}", Command::TYPE_NAME);
                    }
                    self.refused += 1;
                }
            }
        }
    }
}

/// True when the next attempt may succeed: no data, no space, or no peer.
fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionRefused)
}
