//! Reports while an autopilot is awaited: for whom the bench waits, and why it is not armed.

use std::time::{Duration, Instant};

use crate::wait_report::WaitReport;

/// Time after which a connected, started autopilot without a reason for not being armed is reported, with
/// advice where to look.
const UNEXPLAINED: Duration = Duration::from_secs(5);

/// State of the wait for an autopilot.
#[derive(Debug)]
pub(super) struct Waiting {
    name: &'static str,
    report: WaitReport,
    /// Start-up time of the autopilot before anybody arms it.
    grace: Duration,
    /// Time since which it is connected without being armed.
    there_since: Option<Instant>,
    advised: bool,
}

impl Waiting {
    pub(super) fn new(name: &'static str, grace: Duration, now: Instant) -> Self {
        Self { name, report: WaitReport::new(now), grace, there_since: None, advised: false }
    }

    /// Ends the wait, as the autopilot flies.
    pub(super) fn over(&mut self) {
        self.report.over();
    }

    /// Reports the wait; `said` is the reported reason for not being armed, `place` the awaited endpoint.
    /// Returns whether advice where to look for the reason should be given, once.
    pub(super) fn tell(
        &mut self,
        now: Instant,
        there: bool,
        said: Option<&str>,
        place: impl FnOnce() -> String,
    ) -> bool {
        let name = self.name;
        self.there_since = there.then(|| self.there_since.unwrap_or(now));
        let since = |wait: Duration| {
            self.there_since.is_some_and(|since| now.saturating_duration_since(since) >= wait)
        };
        let (started, long) = (since(self.grace), since(self.grace + UNEXPLAINED));
        self.report.tell(now, || match (there, said) {
            (true, Some(words)) => format!("{name} to be armed, which says: {words}"),
            (true, None) if !started => format!("{name} to start (bridge.rc.grace_s)"),
            (true, None) => format!("{name} to be armed"),
            (false, _) => format!("{name} on {}", place()),
        });
        let due = long && said.is_none() && !self.advised;
        self.advised |= due;
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_that_is_there_and_says_nothing_is_told_once_five_seconds_after_its_time_to_start() {
        for grace in [0, 8] {
            let origin = Instant::now();
            let mut waiting = Waiting::new("PX4", Duration::from_secs(grace), origin);
            let mut tell = |s: u64, there, said| {
                waiting.tell(origin + Duration::from_secs(s), there, said, || "tcp 4560".into())
            };
            assert!(!tell(9, false, None), "not there");
            assert!(!tell(10, true, None));
            assert!(!tell(14 + grace, true, None), "{grace} s to start");
            assert!(!tell(15 + grace, true, Some("GPS")), "it said why");
            assert!(tell(16 + grace, true, None));
            assert!(!tell(17 + grace, true, None), "once");
        }
    }
}
