//! The sockets of an autopilot's protocol, by the protocol's own port numbers.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use whirlstand_bridge::autopilot::{Autopilot, AutopilotConfig, AutopilotKind};

use crate::error::NodeError;

/// Longest datagram, and the most that is read from a stream at once.
const BUFFER: usize = 65_536;

/// Bytes that an autopilot may leave unread before it counts as gone.
const UNREAD: usize = 1 << 20;

/// One way to the autopilot.
enum Link {
    /// Datagrams come in; answers go to whoever sent last.
    Answering { socket: UdpSocket, peer: Option<SocketAddr> },
    /// Datagrams go out to one address.
    Sending { socket: UdpSocket, peer: SocketAddr },
    /// The autopilot connects; the newest connection counts.
    Listening { listener: TcpListener, stream: Option<Stream> },
}

struct Stream {
    socket: TcpStream,
    /// What the autopilot has not read yet.
    unsent: Vec<u8>,
}

/// All ways to the autopilot.
pub(super) struct Links {
    links: Vec<Link>,
    lost: bool,
    buffer: Vec<u8>,
    unsendable: u64,
}

impl Links {
    /// Opens the sockets.
    ///
    /// # Errors
    /// [`NodeError::Config`] for an address that is none or is in use.
    pub(super) fn open(options: &AutopilotConfig) -> Result<Self, NodeError> {
        let links = match options.kind {
            AutopilotKind::Px4Hil => vec![px4(&options.px4.link)?],
            AutopilotKind::ArdupilotJson => {
                vec![answering("bridge.ardupilot.bind", &options.ardupilot.bind)?]
            }
            AutopilotKind::BetaflightSitl => {
                let b = &options.betaflight;
                let [raw, motors, state, channels] = b.ports;
                vec![
                    answering("bridge.betaflight.bind", &format!("{}:{raw}", b.bind))?,
                    answering("bridge.betaflight.bind", &format!("{}:{motors}", b.bind))?,
                    sending("bridge.betaflight.host", &format!("{}:{state}", b.host), &b.bind)?,
                    sending("bridge.betaflight.host", &format!("{}:{channels}", b.host), &b.bind)?,
                ]
            }
        };
        Ok(Self { links, lost: false, buffer: vec![0; BUFFER], unsendable: 0 })
    }

    /// Hands everything that waits to the autopilot's protocol.
    pub(super) fn receive(&mut self, autopilot: &mut dyn Autopilot, now: Duration) {
        for port in 0..self.links.len() {
            loop {
                let Some(length) = self.next(port, autopilot) else { break };
                let bytes = std::mem::take(&mut self.buffer);
                autopilot.receive(port, &bytes[..length], now, &mut |port, answer| self.send(port, answer));
                self.buffer = bytes;
            }
        }
    }

    /// Reads from one link into the buffer.
    fn next(&mut self, port: usize, autopilot: &mut dyn Autopilot) -> Option<usize> {
        match &mut self.links[port] {
            Link::Answering { socket, peer } => loop {
                match socket.recv_from(&mut self.buffer) {
                    Ok((length, from)) => {
                        *peer = Some(from);
                        return Some(length);
                    }
                    // The answer before came to nobody: the autopilot is not there, or not there any more.
                    Err(e) if e.kind() == ErrorKind::ConnectionRefused => {}
                    Err(_) => return None,
                }
            },
            Link::Sending { .. } => None,
            Link::Listening { listener, stream } => {
                if let Ok((socket, from)) = listener.accept() {
                    match socket.set_nonblocking(true).and_then(|()| socket.set_nodelay(true)) {
                        Ok(()) => {
                            tracing::info!(%from, "the autopilot has connected");
                            if stream.replace(Stream { socket, unsent: Vec::new() }).is_some() {
                                autopilot.disconnected(port);
                                self.lost = true;
                            }
                        }
                        Err(e) => tracing::warn!(%from, "a connection cannot be used: {e}"),
                    }
                }
                let open = stream.as_mut()?;
                match open.socket.read(&mut self.buffer) {
                    Ok(length) if length > 0 => return Some(length),
                    Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                        return None;
                    }
                    Ok(_) => tracing::warn!("the autopilot has closed its connection"),
                    Err(e) => tracing::warn!("the connection to the autopilot broke: {e}"),
                }
                *stream = None;
                autopilot.disconnected(port);
                self.lost = true;
                None
            }
        }
    }

    /// Whether a connection was lost since the last call.
    pub(super) fn take_lost(&mut self) -> bool {
        std::mem::take(&mut self.lost)
    }

    /// Sends without waiting; what cannot be sent now is counted, and for a stream kept.
    pub(super) fn send(&mut self, port: usize, bytes: &[u8]) {
        let sent = match self.links.get_mut(port) {
            Some(Link::Answering { socket, peer: Some(peer) }) => socket.send_to(bytes, *peer).is_ok(),
            // Nobody listens on a port of an autopilot that is not started: the error comes with the next packet.
            Some(Link::Sending { socket, peer }) => socket.send_to(bytes, *peer).is_ok(),
            Some(Link::Listening { stream: Some(stream), .. }) => stream.send(bytes),
            _ => true,
        };
        self.unsendable += u64::from(!sent);
    }

    /// Packets that could not be sent.
    pub(super) fn unsendable(&self) -> u64 {
        self.unsendable
    }

    /// Waits until something comes, or until `until`; false when nothing came.
    pub(super) fn wait(&self, until: Instant) -> bool {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return false;
        }
        let mut fds: Vec<PollFd<'_>> = self
            .links
            .iter()
            .flat_map(Link::fds)
            .map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN))
            .collect();
        let timeout = Timespec { tv_sec: left.as_secs() as i64, tv_nsec: i64::from(left.subsec_nanos()) };
        // An interrupted wait is looked at as if something had come.
        !matches!(poll(&mut fds, Some(&timeout)), Ok(0))
    }
}

impl Link {
    fn fds(&self) -> Vec<BorrowedFd<'_>> {
        match self {
            Self::Answering { socket, .. } => vec![socket.as_fd()],
            Self::Sending { .. } => Vec::new(),
            Self::Listening { listener, stream } => {
                let stream = stream.iter().map(|s| s.socket.as_fd());
                std::iter::once(listener.as_fd()).chain(stream).collect()
            }
        }
    }
}

impl Stream {
    /// Sends what it can and keeps the rest, so that no message is cut in two; false when the peer does not read.
    fn send(&mut self, bytes: &[u8]) -> bool {
        if self.unsent.len() + bytes.len() > UNREAD {
            return false;
        }
        self.unsent.extend_from_slice(bytes);
        while !self.unsent.is_empty() {
            match self.socket.write(&self.unsent) {
                Ok(length) if length > 0 => drop(self.unsent.drain(..length)),
                // A broken connection is noticed when it is read.
                _ => break,
            }
        }
        true
    }
}

fn refuse(field: &str, address: &str, reason: impl std::fmt::Display) -> NodeError {
    NodeError::Config { field: field.into(), value: address.into(), reason: reason.to_string() }
}

fn resolve(field: &str, address: &str) -> Result<SocketAddr, NodeError> {
    let expected = "an address ADDRESS:PORT is expected, for example 127.0.0.1:9002";
    let mut found =
        address.to_socket_addrs().map_err(|e| refuse(field, address, format!("{e}; {expected}")))?;
    found.next().ok_or_else(|| refuse(field, address, expected))
}

fn bound(field: &str, address: &str) -> Result<UdpSocket, NodeError> {
    let socket = UdpSocket::bind(resolve(field, address)?).map_err(|e| {
        refuse(field, address, format!("the port cannot be had: {e}; end the program that uses it"))
    })?;
    socket.set_nonblocking(true).map_err(|e| refuse(field, address, e))?;
    Ok(socket)
}

fn answering(field: &str, address: &str) -> Result<Link, NodeError> {
    Ok(Link::Answering { socket: bound(field, address)?, peer: None })
}

fn sending(field: &str, address: &str, from: &str) -> Result<Link, NodeError> {
    let peer = resolve(field, address)?;
    Ok(Link::Sending { socket: bound(field, &format!("{from}:0"))?, peer })
}

fn px4(link: &str) -> Result<Link, NodeError> {
    const FIELD: &str = "bridge.px4.link";
    match link.split_once("://") {
        Some(("tcpin", address)) => {
            let listener = TcpListener::bind(resolve(FIELD, address)?).map_err(|e| {
                refuse(FIELD, link, format!("the port cannot be had: {e}; end the program that uses it"))
            })?;
            listener.set_nonblocking(true).map_err(|e| refuse(FIELD, link, e))?;
            Ok(Link::Listening { listener, stream: None })
        }
        Some(("udpin", address)) => answering(FIELD, address),
        _ => Err(refuse(
            FIELD,
            link,
            "tcpin://ADDRESS:PORT, udpin://ADDRESS:PORT or serial://DEVICE:BAUD is expected",
        )),
    }
}
