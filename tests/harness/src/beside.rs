//! Tests in real time that run beside each other, and at the end alone where that failed.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use crate::Outcome;

/// What may run at the same time as a test.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Kind {
    #[default]
    BesideOthers,
    /// Any test but those that use the same, which only one at a time may use.
    Using(&'static str),
    Alone,
}

/// Where tests run that wait for most of their time: so many beside each other, the first of the list first. What fails
/// there is run again when no other test is left: flights in real time take the processors from each other, and on a slow
/// machine a flight then misses its deadlines. Only a failure alone counts.
pub struct Lanes {
    lanes: usize,
    /// Called before a test that runs alone: waits for a machine at rest.
    rest: fn(),
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    /// Tests that have not begun, by their places in the list.
    to_come: BTreeMap<usize, Kind>,
    running: usize,
    in_use: BTreeSet<&'static str>,
    alone: bool,
}

impl State {
    /// The first test of the list that can begin.
    fn next(&self) -> Option<usize> {
        let free = |kind: &Kind| !matches!(kind, Kind::Using(name) if self.in_use.contains(name));
        self.to_come.iter().find(|(_, kind)| free(kind)).map(|(place, _)| *place)
    }
}

/// A test that runs; dropped when it has ended, however it did.
struct Runs<'a> {
    lanes: &'a Lanes,
    kind: Kind,
}

impl Drop for Runs<'_> {
    fn drop(&mut self) {
        let mut state = self.lanes.state();
        match self.kind {
            Kind::Alone => state.alone = false,
            Kind::BesideOthers => state.running -= 1,
            Kind::Using(name) => {
                state.running -= 1;
                state.in_use.remove(name);
            }
        }
        self.lanes.changed.notify_all();
    }
}

impl Lanes {
    /// So many tests run beside each other. Before one runs alone, `rest` waits for a machine at rest.
    pub fn new(lanes: usize, rest: fn()) -> Self {
        Self { lanes, rest, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Runs the test with this place in the list, each test on a thread of its own.
    ///
    /// # Errors
    /// What the machine lacks, also when the test runs alone.
    pub fn run(&self, (place, kind): (usize, Kind), test: impl Fn() -> Outcome) -> Outcome {
        if kind != Kind::Alone {
            let _runs = self.beside_others(place, kind);
            match catch_unwind(AssertUnwindSafe(&test)) {
                Ok(Ok(())) => return Ok(()),
                Ok(Err(missing)) if missing.can_be_installed() => return Err(missing),
                // The machine may have what is missing once the others have ended.
                Ok(Err(_)) => {}
                Err(_) => eprintln!("failed beside other tests: again at the end, alone"),
            }
        }
        let _runs = self.alone();
        (self.rest)();
        test()
    }

    fn beside_others(&self, place: usize, kind: Kind) -> Runs<'_> {
        let mut state = self.state();
        state.to_come.insert(place, kind);
        // Another may be the next now.
        self.changed.notify_all();
        state = self.until(state, |s| !s.alone && s.running < self.lanes && s.next() == Some(place));
        state.to_come.remove(&place);
        state.running += 1;
        if let Kind::Using(name) = kind {
            state.in_use.insert(name);
        }
        self.changed.notify_all();
        Runs { lanes: self, kind }
    }

    fn alone(&self) -> Runs<'_> {
        let last = |s: &State| !s.alone && s.running == 0 && s.to_come.is_empty();
        self.until(self.state(), last).alone = true;
        Runs { lanes: self, kind: Kind::Alone }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn until<'a>(
        &self,
        state: MutexGuard<'a, State>,
        holds: impl Fn(&State) -> bool,
    ) -> MutexGuard<'a, State> {
        self.changed.wait_while(state, |s| !holds(s)).unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::Missing;

    #[test]
    fn what_fails_beside_others_is_run_once_more_when_no_other_is_left() {
        let lanes = Lanes::new(1, || ());
        let (runs, ended) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let seen = AtomicUsize::new(0);
        let failing = || {
            if runs.fetch_add(1, Ordering::SeqCst) == 0 {
                drop(lanes.until(lanes.state(), |s| s.to_come.len() == 2));
                panic!("late");
            }
            seen.store(ended.load(Ordering::SeqCst), Ordering::SeqCst);
            Ok(())
        };
        let other = || {
            ended.fetch_add(1, Ordering::SeqCst);
            Ok(())
        };
        std::thread::scope(|scope| {
            scope.spawn(|| lanes.run((0, Kind::BesideOthers), failing));
            // The one that fails has the lane before there is another.
            drop(lanes.until(lanes.state(), |s| s.running == 1));
            scope.spawn(|| lanes.run((1, Kind::BesideOthers), other));
            scope.spawn(|| lanes.run((2, Kind::BesideOthers), other));
        });
        assert_eq!(runs.into_inner(), 2);
        assert_eq!(seen.into_inner(), 2, "run again before the others had ended");
    }

    #[test]
    fn what_fails_alone_has_failed() {
        let lanes = Lanes::new(1, || ());
        for (kind, attempts) in [(Kind::BesideOthers, 2), (Kind::Alone, 1)] {
            let runs = AtomicUsize::new(0);
            let failing = || {
                assert!(runs.fetch_add(1, Ordering::SeqCst) >= attempts, "late");
                Ok(())
            };
            assert!(catch_unwind(AssertUnwindSafe(|| lanes.run((0, kind), failing))).is_err());
            assert_eq!(runs.into_inner(), attempts);
        }
        let passed = AtomicUsize::new(0);
        let passing = || {
            passed.fetch_add(1, Ordering::SeqCst);
            Ok(())
        };
        assert!(lanes.run((1, Kind::BesideOthers), passing).is_ok());
        assert_eq!(passed.into_inner(), 1, "what passes is run once, also after a failure of another");
    }

    #[test]
    fn what_the_machine_lacks_beside_others_it_may_have_for_one_alone() {
        let lanes = Lanes::new(1, || ());
        let runs = AtomicUsize::new(0);
        let busy = || match runs.fetch_add(1, Ordering::SeqCst) {
            0 => Err(Missing::beyond_this_machine("no processors", "busy")),
            _ => Ok(()),
        };
        assert!(lanes.run((0, Kind::BesideOthers), busy).is_ok());
        assert_eq!(runs.load(Ordering::SeqCst), 2);
        assert!(
            lanes
                .run((1, Kind::BesideOthers), || Err(Missing::installable("no tool", "install it")))
                .is_err()
        );
    }

    #[test]
    fn no_more_run_than_there_are_lanes_and_the_first_of_the_list_first() {
        let lanes = Arc::new(Lanes::new(1, || ()));
        let order = Arc::new(Mutex::new(Vec::new()));
        let first = lanes.beside_others(0, Kind::BesideOthers);
        let threads: Vec<_> = [3, 1, 2]
            .map(|place| {
                let (lanes, order) = (lanes.clone(), order.clone());
                let noted = move || {
                    order.lock().unwrap().push(place);
                    Ok(())
                };
                std::thread::spawn(move || lanes.run((place, Kind::BesideOthers), noted))
            })
            .into();
        let waiting = lanes.until(lanes.state(), |s| s.to_come.len() == 3);
        assert_eq!(waiting.running, 1);
        drop(waiting);
        drop(first);
        threads.into_iter().for_each(|thread| assert!(thread.join().unwrap().is_ok()));
        assert_eq!(*order.lock().unwrap(), [1, 2, 3]);
    }

    #[test]
    fn what_one_test_uses_holds_up_no_other() {
        let lanes = Lanes::new(2, || ());
        let uses = Kind::Using("the only line");
        let first = lanes.beside_others(0, uses);
        let order = Mutex::new(Vec::new());
        let noted = |place: usize| {
            order.lock().unwrap().push(place);
            Ok(())
        };
        std::thread::scope(|scope| {
            let second = scope.spawn(|| lanes.run((1, uses), || noted(1)));
            drop(lanes.until(lanes.state(), |s| s.to_come.contains_key(&1)));
            assert!(lanes.run((2, Kind::BesideOthers), || noted(2)).is_ok(), "it passes the one that waits");
            drop(first);
            assert!(second.join().unwrap().is_ok());
        });
        assert_eq!(*order.lock().unwrap(), [2, 1]);
    }
}
