//! Reports for whom a node waits while its bench stands still, to the launcher, which shows it with the
//! waiting time.

use std::time::{Duration, Instant};

use crate::os::notify_status;

/// Prefix of a status that reports a wait.
pub const WAITING_FOR: &str = "waiting for ";

/// Time between two updates of the report.
const LOOK: Duration = Duration::from_millis(250);

/// Time between two log lines of a node without a launcher.
const REPEAT: Duration = Duration::from_secs(5);

/// Reports for whom a node waits, once per change. A node without a launcher logs it instead, every few
/// seconds.
#[derive(Debug)]
pub(crate) struct WaitReport {
    /// Awaited nodes; `None` while the node does not wait.
    whom: Option<String>,
    since: Instant,
    look: Instant,
    logged: Instant,
    has_launcher: bool,
}

impl WaitReport {
    /// A report without a wait.
    pub fn new(now: Instant) -> Self {
        Self { whom: None, since: now, look: now, logged: now, has_launcher: true }
    }

    /// Reports that the node waits; `whom` returns the awaited nodes.
    pub fn tell(&mut self, now: Instant, whom: impl FnOnce() -> String) {
        if now < self.look {
            return;
        }
        self.look = now + LOOK;
        let whom = whom();
        if self.whom.as_ref() != Some(&whom) {
            (self.since, self.logged) = (now, now);
            self.has_launcher = notify_status(&format!("{WAITING_FOR}{whom}"));
            self.whom = Some(whom);
        } else if !self.has_launcher && now >= self.logged + REPEAT {
            self.logged = now;
            let waited_s = now.duration_since(self.since).as_secs();
            tracing::warn!("{WAITING_FOR}{whom} ({waited_s} s); the bench is paused meanwhile");
        }
    }

    /// Reports that the wait is over.
    #[inline]
    pub fn over(&mut self) {
        if self.whom.take().is_some() {
            notify_status("");
        }
    }
}
