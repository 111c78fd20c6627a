//! How long an autopilot is waited for.

use std::time::{Duration, Instant};

use super::Hil;

/// Longest time awake for an answer: one of an autopilot on this machine that computes fast costs no wake-up then. At
/// most so much, because a node of high priority must not starve the autopilot that it waits for.
const SPIN_TIME: Duration = Duration::from_micros(50);

impl Hil {
    /// Whether one that waits for its sensors still computes on the last ones while the wall clock goes on.
    pub(super) fn is_slow(&mut self) -> bool {
        self.listen();
        let spent = self.sensed_at.elapsed();
        let waits = self.is_realtime && self.autopilot.is_lockstep() && !self.autopilot.is_answered();
        if waits && spent < self.patience {
            self.awaited_since.get_or_insert(self.sensed_at);
            return true;
        }
        if let Some(since) = self.awaited_since.take().filter(|_| !self.told_slow) {
            self.told_slow = true;
            tracing::warn!(
                "{} takes {} ms to answer, and the loop asks every {} ms: its previous outputs are used until then",
                self.name,
                since.elapsed().as_millis(),
                self.period.as_secs_f64() * 1e3
            );
        }
        false
    }

    /// Waits until the autopilot has answered, at most as long as it may take.
    pub(super) fn await_answer(&mut self) {
        let waits = self.autopilot.is_lockstep() && !self.is_realtime;
        let patience = if waits { self.patience } else { self.patience.min(self.period / 2) };
        let until = Instant::now() + patience;
        loop {
            self.listen();
            if self.autopilot.is_answered() || !self.links.wait(until, SPIN_TIME) {
                return;
            }
        }
    }
}
