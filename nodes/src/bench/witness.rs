//! Witness threads that detect standstills of the machine: they only wake periodically.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use crate::NodeError;
use crate::config::RealtimeOptions;
use crate::os::{MonotonicTime, apply_realtime, available_cpus, sleep_until, wake_when_due};

/// Wake-up period, ns; a standstill may have begun by this much before it is detected.
pub(super) const PERIOD_NS: u64 = 100_000;

/// Lateness of a wake-up that counts as a standstill, ns: several times the time for which the loop's own
/// nodes occupy a CPU.
const LATE_NS: u64 = 100_000;

/// Largest number of standstills stored per thread; recording them allocates nothing.
const MOST: usize = 1 << 16;

/// Start and end of a period in which a CPU did not run a due thread, `CLOCK_MONOTONIC`, ns.
pub(super) type Standstill = (u64, u64);

/// One witness on each CPU that this process may use, all at one priority.
pub(super) struct Witnesses {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Result<Vec<Standstill>, NodeError>>>,
}

impl Witnesses {
    /// Starts the witnesses; `None` means ordinary scheduling.
    pub fn start(priority: Option<u8>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let witness = |cpu| {
            let stop = Arc::clone(&stop);
            let options = RealtimeOptions { priority, cpus: vec![cpu], lock_memory: false };
            std::thread::spawn(move || -> Result<Vec<Standstill>, NodeError> {
                wake_when_due();
                apply_realtime(&options)?;
                Ok(watch(&stop))
            })
        };
        let threads = available_cpus().into_iter().map(witness).collect();
        Self { stop, threads }
    }

    /// Stops the witnesses, and returns the standstills of each CPU.
    ///
    /// # Errors
    /// When a witness was refused its priority or CPU.
    pub fn finish(self) -> Result<Vec<Standstill>, NodeError> {
        self.stop.store(true, Ordering::Relaxed);
        let mut all = Vec::new();
        for thread in self.threads {
            all.extend(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?);
        }
        Ok(all)
    }
}

fn watch(stop: &AtomicBool) -> Vec<Standstill> {
    let mut seen = Vec::with_capacity(MOST);
    let mut due = MonotonicTime::now().0 + PERIOD_NS;
    while !stop.load(Ordering::Relaxed) {
        sleep_until(MonotonicTime(due), || stop.load(Ordering::Relaxed));
        let now = MonotonicTime::now().0;
        if now.saturating_sub(due) > LATE_NS && seen.len() < MOST {
            seen.push((due, now));
        }
        due = (due + PERIOD_NS).max(now);
    }
    seen
}

/// Total duration of the CPUs' standstills between two times, ns, summed over CPUs: a sequence of steps on
/// several CPUs can be affected by all.
pub(super) fn stood_still(standstills: &[Standstill], (from, until): (u64, u64)) -> u64 {
    let within = |&(a, b): &Standstill| b.min(until).saturating_sub(a.max(from));
    standstills.iter().map(within).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_within_a_period_counts_of_every_cpu() {
        let seen = [(100, 300), (250, 400), (900, 2000)];
        assert_eq!(stood_still(&seen, (0, 1000)), 200 + 150 + 100);
        assert_eq!(stood_still(&seen, (350, 950)), 50 + 50);
        assert_eq!(stood_still(&seen, (400, 900)), 0);
    }

    #[test]
    fn a_witness_on_every_cpu_says_when_it_was_late() {
        let began = MonotonicTime::now().0;
        let witnesses = Witnesses::start(None);
        assert_eq!(witnesses.threads.len(), available_cpus().len());
        sleep_until(MonotonicTime(began + 20_000_000), || false);
        let seen = witnesses.finish().unwrap();
        let ended = MonotonicTime::now().0;
        assert!(
            seen.iter().all(|(due, woke)| woke - due > LATE_NS && *due > began && *woke < ended),
            "{seen:?}"
        );
    }
}
