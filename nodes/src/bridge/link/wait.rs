//! Waits for input on several links at once.

use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// Waits until something can be read from one of `fds`, or until `until`; false when nothing came.
///
/// For `look` it polls without sleeping: data that arrive meanwhile cost no wake-up, which is most of the
/// latency of a link within one machine. It does not yield while it polls, because a yield to ordinary
/// processes lasts milliseconds; so `look` must be short.
pub fn wait_for_bytes<'f>(fds: impl Iterator<Item = BorrowedFd<'f>>, until: Instant, look: Duration) -> bool {
    let mut fds: Vec<_> = fds.map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)).collect();
    let now = Instant::now();
    let awake = until.min(now + look);
    let mut left = until.saturating_duration_since(now);
    while !left.is_zero() {
        let looks = Instant::now() < awake;
        let limit = if looks { Duration::ZERO } else { left };
        let timeout = Timespec { tv_sec: limit.as_secs() as i64, tv_nsec: i64::from(limit.subsec_nanos()) };
        match poll(&mut fds, Some(&timeout)) {
            Ok(0) if looks => left = until.saturating_duration_since(Instant::now()),
            Ok(0) => return false,
            // An interrupted wait is treated as if something had arrived.
            _ => return true,
        }
    }
    false
}
