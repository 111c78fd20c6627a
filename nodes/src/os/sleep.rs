//! Wake-ups at an absolute time.

use std::time::{Duration, Instant};

/// A time of `CLOCK_MONOTONIC`, ns; the clock of [`Instant`] on Linux.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MonotonicTime(pub u64);

impl MonotonicTime {
    /// The present time.
    pub fn now() -> Self {
        Self(nanoseconds(libc::CLOCK_MONOTONIC))
    }

    /// The same time as an [`Instant`], for waits that take one.
    pub fn instant(self) -> Instant {
        let (now, here) = (Self::now(), Instant::now());
        if self > now {
            here + Duration::from_nanos(self.0 - now.0)
        } else {
            here.checked_sub(Duration::from_nanos(now.0 - self.0)).unwrap_or(here)
        }
    }
}

/// Requests that sleeps of the calling thread, and of threads started later by it, end exactly when they are
/// due. By default the system delays them by up to 50 us to combine wake-ups (`PR_SET_TIMERSLACK`, prctl(2));
/// SCHED_FIFO has no such slack.
pub(crate) fn wake_when_due() {
    // SAFETY: this request takes a number and no pointer; where it is refused, sleeps end as they did before.
    unsafe { libc::prctl(libc::PR_SET_TIMERSLACK, libc::c_ulong::from(1u8), 0, 0, 0) };
}

/// Processor time of this thread, without the time of others.
pub(crate) fn thread_time() -> Duration {
    Duration::from_nanos(nanoseconds(libc::CLOCK_THREAD_CPUTIME_ID))
}

fn nanoseconds(clock: libc::clockid_t) -> u64 {
    let mut t = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `t` is a valid timespec to write to; both clocks that are asked for always exist on Linux.
    unsafe { libc::clock_gettime(clock, &raw mut t) };
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// Sleeps until `t` (`clock_nanosleep` with `TIMER_ABSTIME`, so that being preempted before the call cannot
/// lengthen the sleep); returns early when a signal arrives and `interrupted` says so.
pub fn sleep_until(t: MonotonicTime, interrupted: impl Fn() -> bool) {
    let wake = libc::timespec {
        tv_sec: (t.0 / 1_000_000_000) as libc::time_t,
        tv_nsec: (t.0 % 1_000_000_000) as libc::c_long,
    };
    loop {
        // SAFETY: `wake` is a valid timespec; a null remainder is allowed with TIMER_ABSTIME.
        let status = unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const wake,
                std::ptr::null_mut(),
            )
        };
        if status != libc::EINTR || interrupted() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_can_ask_to_be_woken_when_it_is_due() {
        let slack = std::thread::spawn(|| {
            wake_when_due();
            // SAFETY: this request takes nothing but its number.
            unsafe { libc::prctl(libc::PR_GET_TIMERSLACK) }
        });
        assert_eq!(slack.join().unwrap(), 1);
    }

    #[test]
    fn waking_is_never_early() {
        for wait in [0, 200_000, 2_000_000] {
            let t = MonotonicTime(MonotonicTime::now().0 + wait);
            let instant = t.instant();
            sleep_until(t, || false);
            assert!(MonotonicTime::now() >= t);
            assert!(Instant::now() + Duration::from_micros(1) >= instant);
        }
    }
}
