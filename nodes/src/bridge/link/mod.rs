//! Links to hardware: serial, UDP and TCP, opened again for as long as the bench runs.
//!
//! Nothing here blocks but the caller's own `poll` on [`Link::fd`]. A link that is down is tried again every
//! [`RETRY`]; its sender drops, and counts, what cannot go out at once, because an old command is worth nothing.

mod address;
mod serial;
mod wait;

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use address::{Address, AddressError};
pub use wait::wait_for_bytes;

/// Between two attempts to open a link.
pub const RETRY: Duration = Duration::from_millis(200);

/// Longest wait for a TCP peer; the loop stands still meanwhile, but without a link there is nothing to do.
const CONNECT: Duration = Duration::from_millis(300);

const CLOSED: &str = "the other end closed it";

/// Something that happened to a link.
#[derive(Debug, PartialEq, Eq)]
pub enum LinkEvent {
    /// It is open, for the first time or again.
    Up,
    /// It is closed, and why.
    Down(String),
}

/// What a look at the link gave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received {
    /// Nothing waits.
    Nothing,
    /// So many bytes of a stream.
    Stream(usize),
    /// A datagram of so many bytes.
    Datagram(usize),
}

enum Wire {
    Serial(OwnedFd),
    Tcp(TcpStream),
    Udp { socket: UdpSocket, peer: Option<SocketAddr> },
}

/// What both halves of a link share.
#[derive(Default)]
struct Shared {
    wire: Mutex<Option<Arc<Wire>>>,
    /// The peer of a bound UDP socket, learned from what it sent.
    sender: Mutex<Option<SocketAddr>>,
    dropped: AtomicU64,
}

/// The receiving half; it opens the link.
pub struct Link {
    address: Address,
    listener: Option<TcpListener>,
    wire: Option<Arc<Wire>>,
    shared: Arc<Shared>,
    retry_at: Instant,
    /// Why the last attempt failed, so that it is reported once.
    reported: Option<String>,
}

/// The sending half; any thread may have one.
#[derive(Clone)]
pub struct LinkSender(Arc<Shared>);

impl Link {
    /// A link that is not open yet; [`Link::maintain`] opens it.
    pub fn new(address: Address) -> Self {
        Self {
            address,
            listener: None,
            wire: None,
            shared: Arc::default(),
            retry_at: Instant::now(),
            reported: None,
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

    /// What to poll for input; `None` while it is down and nothing is listened to.
    pub fn fd(&self) -> Option<BorrowedFd<'_>> {
        match (self.wire.as_deref(), &self.listener) {
            (Some(Wire::Serial(fd)), _) => Some(fd.as_fd()),
            (Some(Wire::Tcp(stream)), _) => Some(stream.as_fd()),
            (Some(Wire::Udp { socket, .. }), _) => Some(socket.as_fd()),
            (None, Some(listener)) => Some(listener.as_fd()),
            (None, None) => None,
        }
    }

    /// When to call [`Link::maintain`]; `None` while it is up.
    pub fn retry_at(&self) -> Option<Instant> {
        (!self.is_up()).then_some(self.retry_at)
    }

    /// Opens the link when it is down and an attempt is due.
    pub fn maintain(&mut self, now: Instant) -> Option<LinkEvent> {
        let listened = self.listener.is_some();
        if self.is_up() || (now < self.retry_at && !listened) {
            return None;
        }
        self.retry_at = now + RETRY;
        match self.open() {
            Ok(Some(wire)) => {
                self.reported = None;
                let wire = Arc::new(wire);
                *lock(&self.shared.wire) = Some(wire.clone());
                self.wire = Some(wire);
                Some(LinkEvent::Up)
            }
            Ok(None) => None,
            Err(e) => self.tell(format!("{} cannot be opened: {e}", self.address)),
        }
    }

    /// Takes what waits, at most as much as `buffer` holds.
    ///
    /// # Errors
    /// The link went down; it is opened again by [`Link::maintain`].
    pub fn receive(&mut self, buffer: &mut [u8]) -> Result<Received, LinkEvent> {
        let Some(wire) = self.wire.as_deref() else { return Ok(Received::Nothing) };
        let read = match wire {
            Wire::Serial(port) => rustix::io::read(port, &mut *buffer).map_err(io::Error::from),
            Wire::Tcp(stream) => (&*stream).read(buffer),
            Wire::Udp { socket, peer } => match socket.recv_from(buffer) {
                Ok((length, from)) => {
                    if peer.is_none() {
                        *lock(&self.shared.sender) = Some(from);
                    }
                    return Ok(Received::Datagram(length));
                }
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
        self.wire = None;
        self.retry_at = Instant::now() + RETRY;
        LinkEvent::Down(format!("{} is down: {why}", self.address))
    }

    fn tell(&mut self, why: String) -> Option<LinkEvent> {
        let news = self.reported.as_ref() != Some(&why);
        self.reported = Some(why.clone());
        news.then_some(LinkEvent::Down(why))
    }

    fn open(&mut self) -> io::Result<Option<Wire>> {
        match &self.address {
            Address::Serial { path, baud, even_two } => {
                serial::open_port(path, *baud, *even_two).map(|port| Some(Wire::Serial(port)))
            }
            Address::UdpIn(at) => {
                let socket = UdpSocket::bind(at)?;
                socket.set_nonblocking(true)?;
                Ok(Some(Wire::Udp { socket, peer: None }))
            }
            Address::UdpOut(to) => {
                let any: SocketAddr = if to.is_ipv4() { ([0; 4], 0).into() } else { ([0u16; 8], 0).into() };
                let socket = UdpSocket::bind(any)?;
                socket.set_nonblocking(true)?;
                Ok(Some(Wire::Udp { socket, peer: Some(*to) }))
            }
            Address::TcpOut(to) => TcpStream::connect_timeout(to, CONNECT).and_then(tcp).map(Some),
            Address::TcpIn(at) => {
                let listener = match self.listener.take() {
                    Some(listener) => listener,
                    None => {
                        let listener = TcpListener::bind(at)?;
                        listener.set_nonblocking(true)?;
                        listener
                    }
                };
                let accepted = listener.accept();
                self.listener = Some(listener);
                match accepted {
                    Ok((stream, _)) => tcp(stream).map(Some),
                    Err(e) if e.kind() == io::ErrorKind::WouldBlock => Ok(None),
                    Err(e) => Err(e),
                }
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
            Some(Wire::Serial(port)) => rustix::io::write(port, bytes).is_ok_and(|n| n == bytes.len()),
            Some(Wire::Tcp(stream)) => (&*stream).write(bytes).is_ok_and(|n| n == bytes.len()),
            Some(Wire::Udp { socket, peer }) => match peer.or_else(|| *lock(&self.0.sender)) {
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
