//! Runs flights in several threads until all are flown, enough is known, or a signal arrives.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use crate::error::Failure;
use crate::supervisor::Signals;

/// Time between two checks for a signal.
const GLANCE: Duration = Duration::from_millis(50);

/// Flies each number of `todo`, `jobs` at a time, and hands each result to `take` in this thread, in the order in
/// which the results arrive. `take` answers whether it has enough. Returns whether a signal ended the work before
/// that; flights that have begun are always finished.
///
/// # Errors
/// The errors of `take`, and when no signal handler can be installed.
pub(crate) fn side_by_side<T: Send>(
    todo: &[u64],
    jobs: usize,
    fly: impl Fn(u64) -> T + Sync,
    mut take: impl FnMut(T) -> Result<bool, Failure>,
) -> Result<bool, Failure> {
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let mut signals = Signals::take().map_err(Failure::run)?;
    std::thread::scope(|scope| {
        let (sender, flights) = mpsc::channel();
        for _ in 0..jobs.min(todo.len().max(1)) {
            let (sender, next, stop, fly) = (sender.clone(), &next, &stop, &fly);
            scope.spawn(move || {
                while let Some(number) = todo.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if stop.load(Ordering::Relaxed) || sender.send(fly(*number)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let mut interrupted = false;
        let result = loop {
            match flights.recv_timeout(GLANCE).map(&mut take) {
                Ok(Err(failure)) => break Err(failure),
                Ok(Ok(true)) | Err(RecvTimeoutError::Disconnected) => break Ok(()),
                Ok(Ok(false)) | Err(RecvTimeoutError::Timeout) => {}
            }
            if signals.next().is_some() {
                interrupted = true;
                stop.store(true, Ordering::Relaxed);
            }
        };
        stop.store(true, Ordering::Relaxed);
        result.map(|()| interrupted)
    })
}
