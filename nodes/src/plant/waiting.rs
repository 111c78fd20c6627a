//! How a lockstep plant waits for the answer to its step: as long as it takes, asking again and saying whom it waits for.

use std::time::{Duration, Instant};

use crate::config::Role;
use crate::gate::Gate;
use crate::peers::Peers;

/// After this time without an answer the measurement is sent again: a program that was started again has not heard it, and
/// one that has answers with the same command again.
const REPEAT: Duration = Duration::from_secs(1);

/// Time between two lines that tell whom the plant waits for.
const TELL: Duration = Duration::from_secs(5);

#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    /// Longest wait, where one was asked for.
    timeout: Option<Duration>,
    since: Instant,
    repeated: Instant,
    told: Instant,
}

impl Waiting {
    pub(super) fn new(timeout: Option<Duration>, now: Instant) -> Self {
        Self { timeout, since: now, repeated: now, told: now }
    }

    /// A measurement was published at `now`.
    pub(super) fn begin(&mut self, now: Instant) {
        (self.since, self.repeated) = (now, now);
    }

    /// When the last measurement was published, without its repetitions.
    pub(super) fn since(&self) -> Instant {
        self.since
    }

    /// Whether somebody asked to wait no longer than until now.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.timeout.is_some_and(|longest| now >= self.since + longest)
    }

    /// Time at which to look again, at the latest.
    pub(super) fn wake_at(&self, due: Instant) -> Instant {
        self.timeout.map_or(due, |longest| due.min(self.since + longest))
    }

    /// Whether the measurement is to be sent again; then the next time is a while away.
    pub(super) fn asks_again(&mut self, now: Instant) -> bool {
        let asks = now >= self.repeated + REPEAT;
        if asks {
            self.repeated = now;
        }
        asks
    }

    /// Says every few seconds whom the plant waits for.
    pub(super) fn tell(&mut self, now: Instant, step: u64, whom: impl FnOnce() -> String) {
        if now < self.told.max(self.since) + TELL {
            return;
        }
        self.told = now;
        let (whom, waited_s) = (whom(), now.duration_since(self.since).as_secs());
        tracing::warn!(step, "waiting for {whom} for {waited_s} s; the bench stands still meanwhile");
    }
}

/// Whom a plant waits for: before its first step those who do not run yet, later those who are behind `step`.
pub(super) fn whom(peers: &Peers, gate: &Gate, joining: bool, step: u64) -> String {
    if joining {
        let missing: Vec<_> = peers.not_running().map(Role::name).collect();
        return format!("the {}", missing.join(" and the "));
    }
    let behind = |role: Role| peers.health(role).is_some_and(|peer| peer.step < step);
    let whom = if gate.is_answered() {
        "the recorder to catch up"
    } else if behind(Role::Estimator) {
        "the estimator"
    } else if behind(Role::Controller) {
        "the controller"
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
    fn whom_it_waits_for_is_told_every_five_seconds() {
        let start = Instant::now();
        let mut waiting = Waiting::new(None, start);
        let mut told = 0;
        for tenth in 0..200 {
            waiting.tell(start + Duration::from_millis(100 * tenth), 7, || {
                told += 1;
                "the controller".into()
            });
        }
        assert_eq!(told, 3);
    }
}
