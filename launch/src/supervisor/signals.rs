//! Ctrl-C and SIGTERM as a descriptor that can be polled.

use std::io::{self, Read};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use signal_hook::SigId;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Signals that end a run in order.
const ENDING: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];

/// True after a taker of the signals was dropped: the signals then end the process again. An installed handler
/// stays installed; without this flag a run that computes its report could not be ended.
static UNATTENDED: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Turns the ending signals of this process into readable bytes, until this is dropped.
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
            // The flag is registered first, so that a reader woken by the byte already sees it.
            signals.ids.push(signal_hook::flag::register(signal, Arc::clone(&flag))?);
            signals.ids.push(signal_hook::low_level::pipe::register(signal, writer.try_clone()?)?);
            signals.came.push((signal, flag));
        }
        match UNATTENDED.get() {
            Some(unattended) => unattended.store(false, Ordering::SeqCst),
            None => {
                let unattended = UNATTENDED.get_or_init(Arc::default);
                for signal in ENDING {
                    signal_hook::flag::register_conditional_default(signal, Arc::clone(unattended))?;
                }
            }
        }
        Ok(signals)
    }

    /// Waits for a signal, at most for the time `longest`.
    ///
    /// # Errors
    /// When the operating system refuses polling.
    pub fn wait(&self, longest: Duration) -> io::Result<()> {
        let timeout = Timespec { tv_sec: longest.as_secs() as i64, tv_nsec: longest.subsec_nanos().into() };
        match poll(&mut [PollFd::new(self, PollFlags::IN)], Some(&timeout)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => Ok(()),
            Err(e) => Err(e.into()),
        }
    }

    /// A signal that arrived since the last call.
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
        if let Some(unattended) = UNATTENDED.get() {
            unattended.store(true, Ordering::SeqCst);
        }
        // A signal that arrived too late for the last check is not lost.
        if let Some(signal) = self.next() {
            let _ = signal_hook::low_level::emulate_default_handler(signal);
        }
        for id in self.ids.drain(..) {
            signal_hook::low_level::unregister(id);
        }
    }
}
