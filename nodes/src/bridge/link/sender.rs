//! The sending half of a link, and what it shares with the receiving half.

use std::io::Write;
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::serial;

/// The open port of a link.
pub(super) enum Wire {
    Serial(OwnedFd),
    Tcp(TcpStream),
    Udp { socket: UdpSocket, to: Option<SocketAddr> },
}

/// State shared by both halves of a link.
#[derive(Default)]
pub(super) struct Shared {
    pub wire: Mutex<Option<Arc<Wire>>>,
    /// Peer of a bound UDP socket, adopted by a valid message.
    pub peer: Mutex<Option<SocketAddr>>,
    dropped: AtomicU64,
    /// Largest number of bytes that may wait in the driver of a serial port.
    most_waiting: usize,
}

impl Shared {
    /// A closed link, in whose driver at most this many bytes may wait.
    pub fn new(most_waiting: usize) -> Self {
        Self { most_waiting, ..Self::default() }
    }
}

/// The sending half; usable from any thread.
#[derive(Clone)]
pub struct LinkSender(pub(super) Arc<Shared>);

impl LinkSender {
    /// Sends as much as possible without waiting; true if everything was sent. The rest is dropped and
    /// counted.
    pub fn send(&self, bytes: &[u8]) -> bool {
        let wire = lock(&self.0.wire).clone();
        let sent = match wire.as_deref() {
            None => false,
            // Waiting bytes are obsolete but cannot be withdrawn: so none are added.
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

    /// True while few enough bytes wait in the driver that something less urgent than a command delays none.
    pub fn has_room(&self) -> bool {
        match lock(&self.0.wire).as_deref() {
            Some(Wire::Serial(port)) => 4 * serial::waiting(port) <= self.0.most_waiting,
            _ => true,
        }
    }

    /// Number of sends dropped because the link was closed or congested.
    pub fn dropped(&self) -> u64 {
        self.0.dropped.load(Ordering::Relaxed)
    }
}

/// A panic in another thread cannot leave an inconsistent value here.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
