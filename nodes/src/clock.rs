//! Wall-clock time outside the loop: reports, latencies, time limits.

use std::time::Instant;

/// A clock that is read on every call, or only on every n-th call where a step takes less time than reading
/// the clock.
#[derive(Debug, Clone)]
pub struct Clock {
    every: u32,
    left: u32,
    last: Instant,
}

impl Clock {
    /// A clock that is read on every call.
    pub fn exact() -> Self {
        Self::sampled(1)
    }

    /// A clock that is read on every `every`th call; other calls repeat the last time.
    pub fn sampled(every: u32) -> Self {
        Self { every: every.max(1), left: every.max(1), last: Instant::now() }
    }

    /// True when every call reads the clock, so that differences are latencies.
    pub fn is_exact(&self) -> bool {
        self.every == 1
    }

    /// The time of the last reading.
    pub fn last(&self) -> Instant {
        self.last
    }

    /// The current time; for a sampled clock the time of the last reading.
    #[inline]
    pub fn now(&mut self) -> Instant {
        self.left -= 1;
        if self.left == 0 {
            self.left = self.every;
            self.last = Instant::now();
        }
        self.last
    }
}

/// Result of a node's turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// There is nothing to do until a message comes or time passes.
    Idle,
    /// The node did some work.
    Worked,
    /// The node has reached its end.
    Ended,
}
