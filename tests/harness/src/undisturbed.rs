//! Tests of timing, on a virtual machine whose processors are sometimes taken away.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::{Missing, Outcome};

/// Share of processor time taken by others from which on timing on this machine is not meaningful. In 10 s and with two
/// processors that is 0.4 s in total, longer than the shortest time limits of this project's nodes.
const DISTURBED_SHARE: f64 = 0.02;

/// Most attempts of a test.
const ATTEMPTS: usize = 4;

/// Time over which the host's share is counted to determine whether it is at rest.
const LOOK: Duration = Duration::from_secs(1);

/// Longest wait for a host at rest.
const PATIENCE: Duration = Duration::from_secs(60);

/// Runs a test of real-time figures. If it fails while the host takes the processors away, this machine cannot decide:
/// the result is [`Missing`], and the test is reported as ignored. Use it only for figures of real time.
///
/// # Errors
/// The test failed while others used the processors.
pub fn in_real_time(test: impl FnOnce()) -> Outcome {
    let before = Times::now().unwrap_or_default();
    let Err(failure) = catch_unwind(AssertUnwindSafe(test)) else { return Ok(()) };
    let stolen = Times::now().unwrap_or_default().stolen_since(before);
    if stolen < DISTURBED_SHARE {
        resume_unwind(failure);
    }
    let why = format!("others had {:.0} % of them while the test failed", 100.0 * stolen);
    Err(Missing::beyond_this_machine("no processors of its own", why))
}

/// Returns when the host leaves the processors alone, or after [`PATIENCE`]. The kernel counts the time taken by
/// others but gives no notice of changes, so it is read every second.
pub fn wait_for_rest() {
    let until = Instant::now() + PATIENCE;
    while Instant::now() < until {
        let Some(before) = Times::now() else { return };
        sleep(LOOK);
        if Times::now().is_none_or(|now| now.stolen_since(before) < DISTURBED_SHARE) {
            return;
        }
    }
}

/// Runs a test. If it fails while the host takes the processors away, it is run again, because the tested code is not
/// at fault. On an undisturbed machine, or one that does not count such time, the first failure counts.
pub fn undisturbed<T>(test: impl Fn() -> T) -> T {
    undisturbed_by(&test, || Times::now().unwrap_or_default(), wait_for_rest)
}

fn undisturbed_by<T>(test: impl Fn() -> T, times: impl Fn() -> Times, rest: impl Fn()) -> T {
    for attempt in 1.. {
        let before = times();
        let failure = match catch_unwind(AssertUnwindSafe(&test)) {
            Ok(value) => return value,
            Err(failure) => failure,
        };
        let stolen = times().stolen_since(before);
        if stolen < DISTURBED_SHARE || attempt == ATTEMPTS {
            resume_unwind(failure);
        }
        eprintln!("others had {:.0} % of the processors meanwhile: again", 100.0 * stolen);
        rest();
    }
    unreachable!("an attempt returns or fails")
}

/// Time of all processors since the start, in ticks.
#[derive(Debug, Clone, Copy, Default)]
struct Times {
    all: u64,
    stolen: u64,
}

impl Times {
    /// From the first line of `/proc/stat` (proc_stat(5)): user, nice, system, idle, iowait, irq, softirq, steal.
    fn now() -> Option<Self> {
        Self::parse(&std::fs::read_to_string("/proc/stat").ok()?)
    }

    fn parse(stat: &str) -> Option<Self> {
        let fields = stat.lines().next()?.split_whitespace().skip(1).take(8);
        let ticks: Vec<u64> = fields.map_while(|f| f.parse().ok()).collect();
        Some(Self { all: ticks.iter().sum(), stolen: *ticks.get(7)? })
    }

    /// Share of the time taken by others since `before`.
    fn stolen_since(self, before: Self) -> f64 {
        let all = self.all.saturating_sub(before.all);
        if all == 0 { 0.0 } else { self.stolen.saturating_sub(before.stolen) as f64 / all as f64 }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// Number of runs of a test that always fails, on a machine of which others take `stolen` percent.
    fn runs(stolen: u64) -> usize {
        let (runs, ticks) = (Cell::new(0), Cell::new(0));
        let times = || {
            ticks.set(ticks.get() + 100);
            Times { all: ticks.get(), stolen: ticks.get() / 100 * stolen }
        };
        let failed = catch_unwind(AssertUnwindSafe(|| {
            undisturbed_by(
                || {
                    runs.set(runs.get() + 1);
                    panic!("late")
                },
                times,
                || (),
            )
        }));
        assert!(failed.is_err());
        runs.get()
    }

    #[test]
    fn only_what_fails_on_a_disturbed_machine_is_run_again() {
        assert_eq!(runs(0), 1);
        assert_eq!(runs(40), ATTEMPTS);
        assert_eq!(undisturbed_by(|| 7, Times::default, || ()), 7);
    }

    #[test]
    fn stolen_time_is_the_eighth_figure() {
        let times = Times::parse("cpu  10 0 5 70 5 0 0 10 0 0\ncpu0 1 2 3\n").unwrap();
        assert_eq!((times.all, times.stolen), (100, 10));
        assert!((times.stolen_since(Times::default()) - 0.1).abs() < 1e-12);
    }
}
