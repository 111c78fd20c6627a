//! Wait of a lockstep plant for the answer to its step: unlimited, with repeated measurements and reports on
//! the awaited nodes.

use std::time::{Duration, Instant};

use crate::config::Role;
use crate::gate::Gate;
use crate::peers::Peers;
use crate::wait_report::WaitReport;

/// Time without an answer after which the measurement is repeated: a restarted program has not received it,
/// and one that has answers with the same command again.
const REPEAT: Duration = Duration::from_secs(1);

/// Shortest wait that is reported.
const TELL: Duration = Duration::from_secs(1);

#[derive(Debug)]
pub(super) struct Waiting {
    /// Longest wait, where configured.
    timeout: Option<Duration>,
    since: Instant,
    repeated: Instant,
    report: WaitReport,
}

impl Waiting {
    pub(super) fn new(timeout: Option<Duration>, now: Instant) -> Self {
        Self { timeout, since: now, repeated: now, report: WaitReport::new(now) }
    }

    /// Begins a wait for a measurement published at `now`.
    pub(super) fn begin(&mut self, now: Instant) {
        (self.since, self.repeated) = (now, now);
        self.report.over();
    }

    /// Time at which the last measurement was published, without repetitions.
    pub(super) fn since(&self) -> Instant {
        self.since
    }

    /// True when the configured longest wait is over.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.timeout.is_some_and(|longest| now >= self.since + longest)
    }

    /// Latest time of the next check.
    pub(super) fn wake_at(&self, due: Instant) -> Instant {
        self.timeout.map_or(due, |longest| due.min(self.since + longest))
    }

    /// True when the measurement must be repeated; the next repetition is then scheduled.
    pub(super) fn asks_again(&mut self, now: Instant) -> bool {
        let asks = now >= self.repeated + REPEAT;
        if asks {
            self.repeated = now;
        }
        asks
    }

    /// Reports the awaited nodes, if the wait is long enough.
    pub(super) fn tell(&mut self, now: Instant, whom: impl FnOnce() -> String) {
        if now >= self.since + TELL {
            self.report.tell(now, whom);
        }
    }

    /// Ends the wait.
    pub(super) fn end(&mut self) {
        self.report.over();
    }
}

/// Awaited nodes: before the first step those that hold up the start, later those behind `step` or silent; for step
/// 0, which every node reports before it has done any, only silent ones.
pub(super) fn whom(peers: &Peers, gate: &Gate, joining: bool, step: u64, now: Instant) -> String {
    if joining {
        return peers.missing(now);
    }
    let behind = |role: Role| peers.health(role).is_some_and(|peer| peer.step < step || peer.is_silent(now));
    let whom = if gate.is_answered() {
        if behind(Role::Mirror) && !behind(Role::Recorder) {
            "the mirror to catch up"
        } else {
            "the recorder to catch up"
        }
    } else if behind(Role::Estimator) {
        "the estimator"
    } else if behind(Role::Controller) {
        "the controller"
    } else if step == 0 {
        "the first command"
    } else {
        "a command"
    };
    whom.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_who_asked_for_a_limit_has_one() {
        let start = Instant::now();
        let after = |s: u64| start + Duration::from_secs(s);
        let mut patient = Waiting::new(None, start);
        assert!(!patient.is_over(after(100_000)));
        assert_eq!(patient.wake_at(after(7)), after(7));
        assert!(!patient.asks_again(start) && patient.asks_again(after(2)) && !patient.asks_again(after(2)));
        patient.begin(after(10));
        assert!(!patient.asks_again(after(10)) && patient.since() == after(10));
        let limited = Waiting::new(Some(Duration::from_secs(3)), start);
        assert!(!limited.is_over(after(2)) && limited.is_over(after(3)));
        assert_eq!(limited.wake_at(after(7)), after(3));
    }

    #[test]
    fn whom_it_waits_for_is_asked_for_only_while_the_bench_stands_still() {
        let start = Instant::now();
        let mut waiting = Waiting::new(None, start);
        let mut asked = 0;
        for ms in 0..2000 {
            waiting.tell(start + Duration::from_millis(ms), || {
                asked += 1;
                "the controller".into()
            });
        }
        assert_eq!(asked, 4);
        waiting.begin(start + Duration::from_secs(2));
        waiting.tell(start + Duration::from_millis(2900), || panic!("it has just gone on"));
    }
}
