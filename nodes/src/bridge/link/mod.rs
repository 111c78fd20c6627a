//! Links to hardware: serial, UDP and TCP, reopened as long as the bench runs.
//!
//! Nothing here blocks except the caller's own `poll` on [`Link::fd`]. A closed link is retried every
//! [`RETRY`]; its sender drops, and counts, data that cannot be sent at once, because an old command is
//! useless.
//!
//! The accepted peer of a port that anybody can reach is determined by one [`PeerKeeper`] per link: on UDP an
//! address is adopted by a valid message, on TCP a silent client is replaced by a waiting one.

mod address;
mod configured;
mod drain;
mod own_socket;
mod sender;
mod serial;
mod server;
mod wait;

use std::collections::VecDeque;
use std::io::{self, Read};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::{Duration, Instant};

use whirlstand_bridge::peer::{PeerCounts, PeerKeeper, Pin, SILENCE};

pub use address::{Address, AddressError};
pub use configured::configured;
pub use drain::{BUFFER, Decoder};
use own_socket::own_socket;
pub use sender::LinkSender;
use sender::{Shared, Wire, lock};
use server::TcpServer;
pub use wait::wait_for_bytes;

use crate::os::with_holder;

/// Time between two attempts to open a link.
pub const RETRY: Duration = Duration::from_millis(200);

/// Longest wait for a TCP connection; the loop blocks meanwhile, but without a link there is nothing to do.
const CONNECT: Duration = Duration::from_millis(300);

/// Period of checks for clients that wait for an occupied TCP port.
const LOOK: Duration = Duration::from_millis(100);

const CLOSED: &str = "the other end closed it";

/// Event of a link.
#[derive(Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// The link was opened, for the first time or again.
    Up,
    /// The link was closed, with the reason.
    Down(String),
    /// Another client has replaced the previous one, with the reason.
    Replaced(String),
}

/// Result of a read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Received {
    /// No data wait.
    Nothing,
    /// Bytes of a stream.
    Stream(usize),
    /// A datagram.
    Datagram { length: usize, from: SocketAddr },
}

/// The receiving half; it opens the link.
pub struct Link {
    address: Address,
    server: Option<TcpServer>,
    wire: Option<Arc<Wire>>,
    /// Connected socket that receives only the peer's datagrams on a UDP port.
    own: Option<UdpSocket>,
    shared: Arc<Shared>,
    retry_at: Instant,
    /// Reason for the last failed attempt, so that it is reported once.
    reported: Option<String>,
    peers: PeerKeeper,
    /// Zero of the peer keeper's time.
    origin: Instant,
    look_at: Instant,
    /// Number of consecutive calls that left data waiting.
    full_looks: u32,
    /// True when a flood was reported.
    flooded: bool,
    /// Notes besides those of the peer keeper.
    notes: VecDeque<String>,
    /// The client, or waiting client, that was last reported.
    told: Option<SocketAddr>,
}

impl Link {
    /// A closed link; [`Link::maintain`] opens it.
    pub fn new(address: Address) -> Self {
        Self::with_peer(address, None, SILENCE)
    }

    /// A link that accepts only `pin`, and keeps a peer until it has been silent for `silence`.
    pub fn with_peer(address: Address, pin: Option<Pin>, silence: Duration) -> Self {
        let pin = match &address {
            // Only the addressed host may answer.
            Address::UdpOut(to) => Some(Pin::Host(to.ip())),
            _ => pin,
        };
        let most_waiting = match &address {
            Address::Serial { baud, even_two, .. } => serial::most_waiting(*baud, *even_two),
            _ => 0,
        };
        let now = Instant::now();
        Self {
            address,
            server: None,
            wire: None,
            own: None,
            shared: Arc::new(Shared::new(most_waiting)),
            retry_at: now,
            reported: None,
            peers: PeerKeeper::new(pin, silence),
            origin: now,
            look_at: now,
            full_looks: 0,
            flooded: false,
            notes: VecDeque::new(),
            told: None,
        }
    }

    /// Address of the link.
    pub fn address(&self) -> &Address {
        &self.address
    }

    /// Its sending half.
    pub fn sender(&self) -> LinkSender {
        LinkSender(self.shared.clone())
    }

    /// Whether it is open.
    pub fn is_up(&self) -> bool {
        self.wire.is_some()
    }

    /// File descriptor to poll for input; `None` while the link is closed without a listening socket. Other
    /// senders than the peer do not wake the caller, and are handled at its next call.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        if let Some(own) = &self.own {
            return Some(own.as_fd());
        }
        match (self.wire.as_deref(), &self.server) {
            (Some(Wire::Serial(fd)), _) => Some(fd.as_fd()),
            (Some(Wire::Tcp(stream)), _) => Some(stream.as_fd()),
            (Some(Wire::Udp { socket, .. }), _) => Some(socket.as_fd()),
            (None, Some(server)) => Some(server.fd()),
            (None, None) => None,
        }
    }

    /// Time of the next call of [`Link::maintain`]; `None` while the link is open.
    pub fn retry_at(&self) -> Option<Instant> {
        (!self.is_up()).then_some(self.retry_at)
    }

    /// Number of datagrams and clients refused because of their sender.
    pub fn refused(&self) -> PeerCounts {
        self.peers.counts()
    }

    /// The oldest note for the user, and whether it is a warning.
    pub fn take_note(&mut self) -> Option<(bool, String)> {
        let note = self.peers.note().map(|note| (note.is_warning(), note.to_string()));
        let (warn, text) = note.or_else(|| self.notes.pop_front().map(|text| (true, text)))?;
        Some((warn, format!("{}: {text}", self.address)))
    }

    /// Opens a closed link when an attempt is due, and accepts a waiting TCP client that replaces a silent
    /// one.
    pub fn maintain(&mut self, now: Instant) -> Option<LinkEvent> {
        if self.is_up() {
            return self.look(now);
        }
        if now < self.retry_at && self.server.is_none() {
            return None;
        }
        self.retry_at = now + RETRY;
        match self.open(now) {
            Ok(Some(wire)) => {
                self.reported = None;
                self.install(wire);
                Some(LinkEvent::Up)
            }
            Ok(None) => None,
            Err(e) => self.tell(format!("{} cannot be opened: {e}", self.address)),
        }
    }

    fn install(&mut self, wire: Wire) {
        let wire = Arc::new(wire);
        *lock(&self.shared.wire) = Some(wire.clone());
        self.wire = Some(wire);
    }

    /// Checks for clients that wait for an occupied TCP port.
    fn look(&mut self, now: Instant) -> Option<LinkEvent> {
        let server = self.server.as_mut()?;
        if now < self.look_at {
            return None;
        }
        self.look_at = now + LOOK;
        let at = now.saturating_duration_since(self.origin);
        let holder = self.peers.peer()?;
        let is_free = self.peers.is_free(at);
        let silence = self.peers.silence().as_secs_f64();
        // A failing port is reported when it is needed.
        let waiting = server.waiting(&mut self.peers).ok().flatten();
        let (about, text) = match waiting {
            Some(next) if is_free => {
                let (client, _) = server.take()?;
                self.peers.hold(next, at);
                self.install(Wire::Tcp(client));
                let why = "has sent nothing valid for";
                let text = format!("{}: {holder} {why} {silence} s, and {next} has its place", self.address);
                return Some(LinkEvent::Replaced(text));
            }
            Some(next) => (next, format!("{next} waits: {holder} holds the port and is active")),
            None if is_free && !self.peers.has_spoken() => {
                let next = "the next client takes its place";
                (
                    holder,
                    format!("{holder} holds the port, and has sent nothing valid for {silence} s: {next}"),
                )
            }
            None => return None,
        };
        if self.told.replace(about) != Some(about) {
            self.notes.push_back(text);
        }
        None
    }

    /// Makes the sender of a valid datagram the peer; returns whether it replaces another.
    fn adopt(&mut self, from: SocketAddr, at: Duration) -> bool {
        *lock(&self.shared.peer) = Some(from);
        if let Some(Wire::Udp { socket, .. }) = self.wire.as_deref() {
            // The previous peer's socket occupies the port. Without its own socket the new peer shares the
            // queue of all.
            self.own = None;
            self.own = own_socket(socket, from).ok();
        }
        self.peers.adopt(from, at).is_some()
    }

    /// Receives data of the peer's own socket.
    fn receive_own(&mut self, buffer: &mut [u8]) -> Received {
        // Errors of this socket occur on the open socket as well, and are reported there.
        match self.own.as_ref().map(|own| own.recv_from(buffer)) {
            Some(Ok((length, from))) => Received::Datagram { length, from },
            Some(Err(_)) | None => Received::Nothing,
        }
    }

    /// Receives waiting data, at most the size of `buffer`.
    fn receive(&mut self, buffer: &mut [u8]) -> Result<Received, LinkEvent> {
        let Some(wire) = self.wire.as_deref() else { return Ok(Received::Nothing) };
        let read = match wire {
            Wire::Serial(port) => rustix::io::read(port, &mut *buffer).map_err(io::Error::from),
            Wire::Tcp(stream) => (&*stream).read(buffer),
            Wire::Udp { socket, .. } => match socket.recv_from(buffer) {
                Ok((length, from)) => return Ok(Received::Datagram { length, from }),
                // The peer does not exist yet, or was restarted: one of our datagrams was rejected.
                Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => return Ok(Received::Nothing),
                Err(e) => Err(e),
            },
        };
        match read {
            Ok(0) => Err(self.close(CLOSED)),
            Ok(length) => Ok(Received::Stream(length)),
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted) => {
                Ok(Received::Nothing)
            }
            // Closing with unread data of ours resets the connection, which is a normal close.
            Err(e) if e.kind() == io::ErrorKind::ConnectionReset => Err(self.close(CLOSED)),
            Err(e) => Err(self.close(&e.to_string())),
        }
    }

    fn close(&mut self, why: &str) -> LinkEvent {
        *lock(&self.shared.wire) = None;
        (self.wire, self.own) = (None, None);
        if self.server.is_some() {
            self.peers.release();
        }
        self.retry_at = Instant::now() + RETRY;
        LinkEvent::Down(format!("{} is down: {why}", self.address))
    }

    fn tell(&mut self, why: String) -> Option<LinkEvent> {
        let news = self.reported.as_ref() != Some(&why);
        self.reported = Some(why.clone());
        news.then_some(LinkEvent::Down(why))
    }

    fn open(&mut self, now: Instant) -> io::Result<Option<Wire>> {
        match &self.address {
            Address::Serial { path, baud, even_two } => {
                serial::open_port(path, *baud, *even_two).map(|port| Some(Wire::Serial(port)))
            }
            Address::UdpIn(at) => {
                let socket = UdpSocket::bind(at).map_err(|e| with_holder(e, *at, false))?;
                socket.set_nonblocking(true)?;
                Ok(Some(Wire::Udp { socket, to: None }))
            }
            Address::UdpOut(to) => {
                let any: SocketAddr = if to.is_ipv4() { ([0; 4], 0).into() } else { ([0u16; 8], 0).into() };
                let socket = UdpSocket::bind(any)?;
                socket.set_nonblocking(true)?;
                Ok(Some(Wire::Udp { socket, to: Some(*to) }))
            }
            Address::TcpOut(to) => TcpStream::connect_timeout(to, CONNECT).and_then(tcp).map(Some),
            Address::TcpIn(at) => {
                let server = match &mut self.server {
                    Some(server) => server,
                    closed => closed.insert(TcpServer::bind(*at)?),
                };
                let Some(address) = server.waiting(&mut self.peers)? else { return Ok(None) };
                self.peers.hold(address, now.saturating_duration_since(self.origin));
                Ok(server.take().map(|(client, _)| Wire::Tcp(client)))
            }
        }
    }
}

fn tcp(stream: TcpStream) -> io::Result<Wire> {
    stream.set_nonblocking(true)?;
    stream.set_nodelay(true)?;
    Ok(Wire::Tcp(stream))
}

#[cfg(test)]
mod tests;
