//! Ctrl-C and SIGTERM as something that can be polled.

use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::SigId;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Signals that end a run in order.
const ENDING: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];

/// Turns the ending signals of this process into readable bytes, until dropped.
#[derive(Debug)]
pub(crate) struct Signals {
    stream: UnixStream,
    came: Vec<(i32, Arc<AtomicBool>)>,
    ids: Vec<SigId>,
}

impl Signals {
    /// Takes over SIGINT, SIGTERM and SIGHUP (a closed terminal).
    ///
    /// # Errors
    /// When the handlers cannot be installed.
    pub fn take() -> io::Result<Self> {
        let (stream, writer) = UnixStream::pair()?;
        stream.set_nonblocking(true)?;
        let mut signals = Self { stream, came: Vec::new(), ids: Vec::new() };
        for signal in ENDING {
            let flag = Arc::new(AtomicBool::new(false));
            // The flag is registered first: whoever is woken by the byte already sees it.
            signals.ids.push(signal_hook::flag::register(signal, Arc::clone(&flag))?);
            signals.ids.push(signal_hook::low_level::pipe::register(signal, writer.try_clone()?)?);
            signals.came.push((signal, flag));
        }
        Ok(signals)
    }

    /// A signal that came since the last call.
    pub fn next(&mut self) -> Option<i32> {
        let mut buffer = [0; 64];
        while matches!(self.stream.read(&mut buffer), Ok(n) if n > 0) {}
        self.came.iter().find(|(_, flag)| flag.swap(false, Ordering::Relaxed)).map(|(signal, _)| *signal)
    }
}

impl AsFd for Signals {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}

impl Drop for Signals {
    fn drop(&mut self) {
        for id in self.ids.drain(..) {
            signal_hook::low_level::unregister(id);
        }
    }
}
