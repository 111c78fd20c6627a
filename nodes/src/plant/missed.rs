//! Missed deadlines with their times.

use crate::os::MonotonicTime;

/// Largest number of missed periods whose times are stored; all are counted.
const MOST: usize = 4096;

/// Number and times of missed deadlines in a realtime loop. Recording one allocates nothing.
#[derive(Debug)]
pub(super) struct Missed {
    /// Number of deadlines that passed while the plant itself was not running.
    overruns: u64,
    /// Number of misses counted by the gate.
    closed: u64,
    /// Start times of the missed periods, `CLOCK_MONOTONIC`, ns.
    began: Vec<u64>,
}

impl Missed {
    pub fn new() -> Self {
        Self { overruns: 0, closed: 0, began: Vec::with_capacity(MOST) }
    }

    /// Records the whole periods that have passed since a deadline, and returns their number.
    pub fn overrun(&mut self, deadline: MonotonicTime, period_ns: u64) -> u64 {
        let late = MonotonicTime::now().0.saturating_sub(deadline.0) / period_ns;
        (0..late).for_each(|period| self.note(deadline.0 + period * period_ns));
        self.overruns += late;
        late
    }

    /// Records that the gate was closed at a deadline, if there is one, with its number of misses so far.
    pub fn closed(&mut self, misses: u64, deadline: Option<MonotonicTime>, period_ns: u64) {
        let more = misses > std::mem::replace(&mut self.closed, misses);
        if let Some(deadline) = deadline.filter(|_| more) {
            self.note(deadline.0.saturating_sub(period_ns));
        }
    }

    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    pub fn began(&self) -> &[u64] {
        &self.began
    }

    fn note(&mut self, began_ns: u64) {
        if self.began.len() < MOST {
            self.began.push(began_ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_period_is_noted_when_its_command_did_not_come() {
        let mut missed = Missed::new();
        missed.closed(0, Some(MonotonicTime(3_000)), 1_000);
        missed.closed(1, Some(MonotonicTime(4_000)), 1_000);
        missed.closed(1, Some(MonotonicTime(5_000)), 1_000);
        // In lockstep there is no deadline.
        missed.closed(2, None, 1_000);
        assert_eq!((missed.began(), missed.overruns()), (&[3_000][..], 0));
        let past = MonotonicTime(MonotonicTime::now().0 - 2_500_000);
        let late = missed.overrun(past, 1_000_000);
        assert!(late >= 2 && missed.overruns() == late, "{late}");
        assert_eq!(missed.began()[1..3], [past.0, past.0 + 1_000_000]);
    }
}
