//! The flights side by side, one thread each, until all are flown, enough is known, or a signal comes.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use indicatif::ProgressBar;
use whirlstand_campaign::{Flight, Proportion};

use super::flyer::Flyer;
use super::journal::Journal;
use crate::error::Failure;
use crate::supervisor::Signals;

/// How often to look whether a signal came.
const GLANCE: Duration = Duration::from_millis(50);

/// Flights between two looks whether enough is known. Only flights without a gap before them count, so that the end does
/// not depend on which thread was faster.
const BATCH: usize = 64;

/// What is known when the flights end.
pub(super) struct Flown {
    /// The flights, by number.
    pub flights: BTreeMap<u64, Flight>,
    /// So many are the campaign, where it ended early because enough was known.
    pub enough: Option<u64>,
    /// A signal ended it.
    pub interrupted: bool,
}

/// Flies `numbers` beside what is `done` already.
///
/// # Errors
/// When the journal cannot be written.
pub(super) fn fly_all(
    flyer: &Flyer,
    numbers: &[u64],
    done: BTreeMap<u64, Flight>,
    (jobs, until_width): (usize, Option<f64>),
    journal: &mut Journal,
    bar: &ProgressBar,
) -> Result<Flown, Failure> {
    let todo: Vec<u64> = numbers.iter().copied().filter(|n| !done.contains_key(n)).collect();
    let mut flown = Flown { flights: done, enough: None, interrupted: false };
    let mut width = until_width.map(|width| Width { width, seen: 0, broken: 0, next: 0 });
    if enough(&mut width, &mut flown) {
        return Ok(flown);
    }
    let (next, stop) = (AtomicUsize::new(0), AtomicBool::new(false));
    let mut signals = Signals::take().map_err(Failure::run)?;
    std::thread::scope(|scope| {
        let (sender, flights) = mpsc::channel();
        for _ in 0..jobs.min(todo.len().max(1)) {
            let (sender, next, stop, todo) = (sender.clone(), &next, &stop, &todo);
            scope.spawn(move || {
                while let Some(number) = todo.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if stop.load(Ordering::Relaxed) || sender.send(flyer.fly(*number)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        let result = loop {
            match flights.recv_timeout(GLANCE) {
                Ok(flight) => {
                    if let Err(failure) = journal.add(&flight) {
                        break Err(failure);
                    }
                    bar.inc(1);
                    flown.flights.insert(flight.number, flight);
                    if enough(&mut width, &mut flown) {
                        break Ok(());
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break Ok(()),
            }
            if signals.next().is_some() {
                flown.interrupted = true;
                stop.store(true, Ordering::Relaxed);
            }
        };
        // Those under way come to their end.
        stop.store(true, Ordering::Relaxed);
        result
    })?;
    flown.interrupted &= flown.flights.len() < numbers.len();
    Ok(flown)
}

/// When to end early.
struct Width {
    width: f64,
    /// Flights without a gap before them, and those of them that broke a limit.
    seen: u64,
    broken: u64,
    next: u64,
}

/// Whether the flights that are there suffice.
fn enough(width: &mut Option<Width>, flown: &mut Flown) -> bool {
    let Some(width) = width else { return false };
    while let Some(flight) = flown.flights.get(&width.next) {
        width.next += 1;
        width.seen += 1;
        width.broken += u64::from(!flight.is_good());
        if width.seen.is_multiple_of(BATCH as u64)
            && Proportion::new(width.broken, width.seen).width() <= width.width
        {
            flown.enough = Some(width.seen);
            flown.flights.retain(|number, _| *number < width.seen);
            return true;
        }
    }
    false
}
