//! Whom a node waits for while its bench stands still: told to the launcher, which shows it with the time that it takes.

use std::time::{Duration, Instant};

use crate::os::notify_status;

/// What a status begins with that says whom its node waits for.
pub const WAITING_FOR: &str = "waiting for ";

/// Time between two looks whether it is still the same.
const LOOK: Duration = Duration::from_millis(250);

/// Time between two log lines of a node that has no launcher.
const REPEAT: Duration = Duration::from_secs(5);

/// Tells whom a node waits for, once for each that it waits for. A node without a launcher writes it into its log instead,
/// every few seconds.
#[derive(Debug)]
pub(crate) struct WaitReport {
    /// `None` while the node waits for nobody.
    whom: Option<String>,
    since: Instant,
    look: Instant,
    logged: Instant,
    has_launcher: bool,
}

impl WaitReport {
    /// Nobody is waited for.
    pub fn new(now: Instant) -> Self {
        Self { whom: None, since: now, look: now, logged: now, has_launcher: true }
    }

    /// The node waits, for whom `whom` says.
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

    /// The node waits for nobody any more.
    #[inline]
    pub fn over(&mut self) {
        if self.whom.take().is_some() {
            notify_status("");
        }
    }
}
