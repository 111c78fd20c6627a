//! Tests in real time that run beside each other, and alone where that fails.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{PoisonError, RwLock};

/// Read by tests that run beside others, written by one that runs alone.
static RUNNING: RwLock<()> = RwLock::new(());

/// Runs a test beside others. Flights in real time take the processors from each other, and on a slow machine a flight then
/// misses its deadlines: a test that fails is run again when no other runs, and only that failure counts.
pub fn beside_others<T>(test: impl Fn() -> T) -> T {
    beside(&RUNNING, test)
}

fn beside<T>(running: &RwLock<()>, test: impl Fn() -> T) -> T {
    {
        let _beside = running.read().unwrap_or_else(PoisonError::into_inner);
        if let Ok(value) = catch_unwind(AssertUnwindSafe(&test)) {
            return value;
        }
    }
    eprintln!("failed beside other tests: again, alone");
    let _alone = running.write().unwrap_or_else(PoisonError::into_inner);
    test()
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    #[test]
    fn what_fails_beside_others_is_run_once_more_and_alone() {
        let running = RwLock::new(());
        let runs = Cell::new(0);
        let alone = || {
            runs.set(runs.get() + 1);
            assert!(running.try_read().is_err(), "another may run");
            runs.get()
        };
        assert_eq!(beside(&running, alone), 2);
        assert!(running.try_write().is_ok(), "others may run again");
    }

    #[test]
    fn what_fails_alone_has_failed() {
        let (running, runs) = (RwLock::new(()), Cell::new(0));
        let failed = catch_unwind(AssertUnwindSafe(|| {
            beside(&running, || {
                runs.set(runs.get() + 1);
                assert!(runs.get() > 2, "late");
            })
        }));
        assert!(failed.is_err());
        assert_eq!(runs.get(), 2);
        let passed = Cell::new(0);
        beside(&running, || passed.set(passed.get() + 1));
        assert_eq!(passed.get(), 1, "what passes is run once, also after a failure of another");
    }
}
