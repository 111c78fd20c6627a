//! TCP server for one client at a time, with one more waiting.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};

use whirlstand_bridge::peer::PeerKeeper;

use crate::os::with_holder;

/// Largest number of clients rejected per call, so that a flood does not block.
const AT_ONCE: usize = 8;

/// The listening port with its waiting client.
pub(super) struct TcpServer {
    listener: TcpListener,
    waiting: Option<(TcpStream, SocketAddr)>,
}

impl TcpServer {
    /// Listens at an address.
    ///
    /// # Errors
    /// The error of the operating system.
    pub(super) fn bind(at: SocketAddr) -> io::Result<Self> {
        let listener = TcpListener::bind(at).map_err(|e| with_holder(e, at, true))?;
        listener.set_nonblocking(true)?;
        Ok(Self { listener, waiting: None })
    }

    pub(super) fn fd(&self) -> BorrowedFd<'_> {
        self.listener.as_fd()
    }

    /// The client that waits and has not left.
    ///
    /// # Errors
    /// The port fails.
    pub(super) fn waiting(&mut self, peers: &mut PeerKeeper) -> io::Result<Option<SocketAddr>> {
        for _ in 0..AT_ONCE {
            if let Some((client, address)) = &self.waiting {
                if !has_left(client) {
                    return Ok(Some(*address));
                }
                self.waiting = None;
            }
            match self.listener.accept() {
                Ok((client, address)) if peers.admits(address) => {
                    client.set_nonblocking(true)?;
                    client.set_nodelay(true)?;
                    self.waiting = Some((client, address));
                }
                // Dropped, and thereby closed.
                Ok(_) => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => return Ok(None),
                // It left before it was accepted.
                Err(e) if matches!(e.kind(), ErrorKind::ConnectionAborted | ErrorKind::Interrupted) => {}
                Err(e) => return Err(e),
            }
        }
        Ok(None)
    }

    /// Accepts the waiting client.
    pub(super) fn take(&mut self) -> Option<(TcpStream, SocketAddr)> {
        self.waiting.take()
    }
}

fn has_left(client: &TcpStream) -> bool {
    match client.peek(&mut [0]) {
        Ok(length) => length == 0,
        Err(e) => !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
    }
}
