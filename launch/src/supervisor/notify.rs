//! Readiness by event: the receiving end of the `sd_notify` protocol (systemd's sd_notify(3)).

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};

/// Longest datagram that is read, bytes; a longer one is cut, and the cut line is dropped.
const LONGEST: usize = 8192;

/// Most datagrams that are read in one call.
const MOST_AT_ONCE: usize = 64;

/// A message of a node on its notify socket.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Notice {
    /// `READY=1`: its ports are open.
    Ready,
    /// `STATUS=...`: one line for people.
    Status(String),
    /// `X_LOCATOR=...`: an address on which peers can reach it.
    Locator(String),
}

/// The notify socket of one process, whose path is in its `NOTIFY_SOCKET`.
#[derive(Debug)]
pub(crate) struct NotifySocket {
    socket: UnixDatagram,
    path: PathBuf,
}

impl NotifySocket {
    /// Binds a socket as a file, which, unlike an abstract name, can also be reached from another network
    /// namespace.
    ///
    /// # Errors
    /// When the file cannot be made.
    pub fn bind(folder: &Path, name: &str) -> io::Result<Self> {
        let path = folder.join(format!("{name}.notify"));
        let socket = UnixDatagram::bind(&path)?;
        socket.set_nonblocking(true)?;
        Ok(Self { socket, path })
    }

    /// Value of `NOTIFY_SOCKET`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The messages received since the last call, at most [`MOST_AT_ONCE`] datagrams, so that an endless
    /// sender has to wait.
    pub fn drain(&self) -> Vec<Notice> {
        let mut notices = Vec::new();
        let mut buffer = [0; LONGEST];
        for _ in 0..MOST_AT_ONCE {
            let Ok(n) = self.socket.recv(&mut buffer) else { break };
            notices.extend(parse(&String::from_utf8_lossy(&buffer[..n])));
        }
        notices
    }
}

impl AsFd for NotifySocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Drop for NotifySocket {
    fn drop(&mut self) {
        // The folder is temporary and removed as a whole, so a failure here does not matter.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// The known assignments in one datagram; others are meant for other supervisors.
fn parse(text: &str) -> Vec<Notice> {
    let known = |line: &str| match line.split_once('=')? {
        ("READY", "1") => Some(Notice::Ready),
        ("STATUS", status) => Some(Notice::Status(status.into())),
        ("X_LOCATOR", locator) => Some(Notice::Locator(locator.into())),
        _ => None,
    };
    let mut notices: Vec<_> = text.lines().filter_map(known).collect();
    // Readiness comes last, so that its receiver already knows the addresses in the same datagram.
    notices.sort_by_key(|n| *n == Notice::Ready);
    notices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn datagrams_are_heard_in_order_and_readiness_comes_last() {
        let folder = tempfile::tempdir().unwrap();
        let socket = NotifySocket::bind(folder.path(), "plant").unwrap();
        let sender = UnixDatagram::unbound().unwrap();
        sender.send_to(b"READY=1\nX_LOCATOR=tcp/127.0.0.1:4\nMAINPID=3", socket.path()).unwrap();
        sender.send_to(b"STATUS=flying", socket.path()).unwrap();
        sender.send_to(b"READY=0\n\xff\xff", socket.path()).unwrap();
        assert_eq!(
            socket.drain(),
            [Notice::Locator("tcp/127.0.0.1:4".into()), Notice::Ready, Notice::Status("flying".into())]
        );
        assert!(socket.drain().is_empty());
    }
}
