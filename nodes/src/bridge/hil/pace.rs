//! Waiting for an autopilot's answer.

use std::time::{Duration, Instant};

use super::Hil;

/// Longest busy wait for an answer: a fast autopilot on this machine then costs no wake-up. It is short,
/// because a node of high priority must not starve the autopilot for which it waits.
const SPIN_TIME: Duration = Duration::from_micros(50);

impl Hil {
    /// True when an autopilot in lockstep still processes the last sensors while the wall clock advances.
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

    /// Waits until the autopilot has answered, at most its longest answer time.
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
