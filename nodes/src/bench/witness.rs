//! When the machine itself stood still: threads that do nothing but wake.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use crate::NodeError;
use crate::config::RealtimeOptions;
use crate::os::{MonotonicTime, apply_realtime, available_cpus, sleep_until, wake_when_due};

/// From wake to wake, ns; a standstill may have begun by as much before it is seen.
pub(super) const PERIOD_NS: u64 = 100_000;

/// A wake that is so late is a standstill, ns: several times what the loop's own nodes keep a CPU for.
const LATE_NS: u64 = 100_000;

/// Standstills that a thread holds; noting them allocates nothing.
const MOST: usize = 1 << 16;

/// From when until when a CPU did not run what was due, `CLOCK_MONOTONIC`, ns.
pub(super) type Standstill = (u64, u64);

/// One witness on each CPU that this process may use, all at one priority.
pub(super) struct Witnesses {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Result<Vec<Standstill>, NodeError>>>,
}

impl Witnesses {
    /// Starts them; `None` is an ordinary priority.
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

    /// Ends them, and tells when each CPU stood still.
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

/// For how long CPUs stood still between two times, ns, each for itself: what runs one after the other on several of them can
/// be met by all.
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
