//! Links to hardware: serial, UDP and TCP, opened again for as long as the bench runs.
//!
//! Nothing here blocks but the caller's own `poll` on [`Link::fd`]. A link that is down is tried again every
//! [`RETRY`]; its sender drops, and counts, what cannot go out at once, because an old command is worth nothing.
//!
//! Who is believed on a port that anybody can reach is decided by one [`PeerKeeper`] for each link: on UDP an address is
//! adopted by a valid message, on TCP a client that is silent gives way to one that waits.

mod address;
mod configured;
mod drain;
mod own_socket;
mod serial;
mod server;
mod wait;

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use whirlstand_bridge::peer::{PeerCounts, PeerKeeper, Pin, SILENCE};

pub use address::{Address, AddressError};
pub use configured::configured;
pub use drain::{BUFFER, Decoder};
use own_socket::own_socket;
use server::TcpServer;
pub use wait::wait_for_bytes;

use crate::os::with_holder;

/// Between two attempts to open a link.
pub const RETRY: Duration = Duration::from_millis(200);

/// Longest wait for a TCP peer; the loop stands still meanwhile, but without a link there is nothing to do.
const CONNECT: Duration = Duration::from_millis(300);

/// Between two looks at who waits for a TCP port that is taken.
const LOOK: Duration = Duration::from_millis(100);

const CLOSED: &str = "the other end closed it";

/// Something that happened to a link.
#[derive(Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// It is open, for the first time or again.
    Up,
    /// It is closed, and why.
    Down(String),
    /// It is open with another client, and why.
    Replaced(String),
}

/// What a look at the link gave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Received {
    /// Nothing waits.
    Nothing,
    /// So many bytes of a stream.
    Stream(usize),
    /// A datagram.
    Datagram { length: usize, from: SocketAddr },
}

enum Wire {
    Serial(OwnedFd),
    Tcp(TcpStream),
    Udp { socket: UdpSocket, to: Option<SocketAddr> },
}

/// What both halves of a link share.
#[derive(Default)]
struct Shared {
    wire: Mutex<Option<Arc<Wire>>>,
    /// The peer of a bound UDP socket, adopted by what it said.
    peer: Mutex<Option<SocketAddr>>,
    dropped: AtomicU64,
    /// Bytes that may wait in the driver of a serial port.
    most_waiting: usize,
}

/// The receiving half; it opens the link.
pub struct Link {
    address: Address,
    server: Option<TcpServer>,
    wire: Option<Arc<Wire>>,
    /// What the peer sends to a UDP port comes in here.
    own: Option<UdpSocket>,
    shared: Arc<Shared>,
    retry_at: Instant,
    /// Why the last attempt failed, so that it is reported once.
    reported: Option<String>,
    peers: PeerKeeper,
    /// Zero of the keeper's time.
    origin: Instant,
    look_at: Instant,
    /// Looks in a row that left something waiting.
    full_looks: u32,
    /// That was told.
    flooded: bool,
    /// What is to be told beside what the keeper tells.
    notes: VecDeque<String>,
    /// The client, or the one who waits, of whom was told last.
    told: Option<SocketAddr>,
}

/// The sending half; any thread may have one.
#[derive(Clone)]
pub struct LinkSender(Arc<Shared>);

impl Link {
    /// A link that is not open yet; [`Link::maintain`] opens it.
    pub fn new(address: Address) -> Self {
        Self::with_peer(address, None, SILENCE)
    }

    /// One that believes `pin` alone, and keeps a peer until it has been silent for `silence`.
    pub fn with_peer(address: Address, pin: Option<Pin>, silence: Duration) -> Self {
        let pin = match &address {
            // Who is spoken to is who may answer.
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
            shared: Arc::new(Shared { most_waiting, ..Shared::default() }),
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

    /// Where it goes.
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

    /// What to poll for input; `None` while it is down and nothing is listened to. Who is not the peer wakes nobody, and
    /// is looked at when the caller looks anyway.
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

    /// When to call [`Link::maintain`]; `None` while it is up.
    pub fn retry_at(&self) -> Option<Instant> {
        (!self.is_up()).then_some(self.retry_at)
    }

    /// What was refused because of who sent it.
    pub fn refused(&self) -> PeerCounts {
        self.peers.counts()
    }

    /// The oldest thing that the user is to know of the link, and whether it is a warning.
    pub fn take_note(&mut self) -> Option<(bool, String)> {
        let note = self.peers.note().map(|note| (note.is_warning(), note.to_string()));
        let (warn, text) = note.or_else(|| self.notes.pop_front().map(|text| (true, text)))?;
        Some((warn, format!("{}: {text}", self.address)))
    }

    /// Opens the link when it is down and an attempt is due, and lets a TCP client in that waits for one who is silent.
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

    /// Looks at who waits for a TCP port that is taken.
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
        // A port that fails is told when it is needed.
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

    /// Makes the sender of a valid datagram the peer; whether there was another before.
    fn adopt(&mut self, from: SocketAddr, at: Duration) -> bool {
        *lock(&self.shared.peer) = Some(from);
        if let Some(Wire::Udp { socket, .. }) = self.wire.as_deref() {
            // The one before has the port until then. Without one of its own the peer shares the queue of all.
            self.own = None;
            self.own = own_socket(socket, from).ok();
        }
        self.peers.adopt(from, at).is_some()
    }

    /// Takes what the peer sent to a socket of its own.
    fn receive_own(&mut self, buffer: &mut [u8]) -> Received {
        // What is wrong with it is wrong with the open socket as well, and told there.
        match self.own.as_ref().map(|own| own.recv_from(buffer)) {
            Some(Ok((length, from))) => Received::Datagram { length, from },
            Some(Err(_)) | None => Received::Nothing,
        }
    }

    /// Takes what waits, at most as much as `buffer` holds.
    fn receive(&mut self, buffer: &mut [u8]) -> Result<Received, LinkEvent> {
        let Some(wire) = self.wire.as_deref() else { return Ok(Received::Nothing) };
        let read = match wire {
            Wire::Serial(port) => rustix::io::read(port, &mut *buffer).map_err(io::Error::from),
            Wire::Tcp(stream) => (&*stream).read(buffer),
            Wire::Udp { socket, .. } => match socket.recv_from(buffer) {
                Ok((length, from)) => return Ok(Received::Datagram { length, from }),
                // The peer is not there yet, or was restarted: a datagram of ours bounced.
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
            // What closes with something of ours unread resets the connection: it is closed all the same.
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

impl LinkSender {
    /// Sends what can go out at once, and says whether all of it could. The rest is dropped and counted.
    pub fn send(&self, bytes: &[u8]) -> bool {
        let wire = lock(&self.0.wire).clone();
        let sent = match wire.as_deref() {
            None => false,
            // What is new supersedes what waits, and there is no way to take that back: so it is not added to.
            Some(Wire::Serial(port)) if serial::waiting(port) > self.0.most_waiting => false,
            Some(Wire::Serial(port)) => rustix::io::write(port, bytes).is_ok_and(|n| n == bytes.len()),
            Some(Wire::Tcp(stream)) => (&*stream).write(bytes).is_ok_and(|n| n == bytes.len()),
            Some(Wire::Udp { socket, to }) => match to.or_else(|| *lock(&self.0.peer)) {
                Some(to) => socket.send_to(bytes, to).is_ok(),
                None => false,
            },
        };
        if !sent {
            self.0.dropped.fetch_add(1, Ordering::Relaxed);
        }
        sent
    }

    /// How often something was dropped because the link was down or could not keep up.
    pub fn dropped(&self) -> u64 {
        self.0.dropped.load(Ordering::Relaxed)
    }
}

fn tcp(stream: TcpStream) -> io::Result<Wire> {
    stream.set_nonblocking(true)?;
    stream.set_nodelay(true)?;
    Ok(Wire::Tcp(stream))
}

/// A thread that panicked in between cannot have left half a value here.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
