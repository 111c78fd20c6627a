//! The flights of a campaign, until all are flown, enough is known, or a signal comes.

use std::collections::BTreeMap;

use indicatif::ProgressBar;
use whirlstand_campaign::{Flight, Proportion};
use whirlstand_nodes::flight::LANES;

use super::flyer::Flyer;
use super::journal::Journal;
use super::side_by_side::side_by_side;
use crate::error::Failure;

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
    // As many as fly side by side, or fewer, so that no thread is left without.
    let groups: Vec<&[u64]> = todo.chunks(LANES.min(todo.len().div_ceil(jobs)).max(1)).collect();
    let numbers_of_groups: Vec<u64> = (0..groups.len() as u64).collect();
    flown.interrupted = side_by_side(
        &numbers_of_groups,
        jobs,
        |group| flyer.fly_some(groups[group as usize]),
        |flights| {
            for flight in flights {
                journal.add(&flight)?;
                bar.inc(1);
                flown.flights.insert(flight.number, flight);
            }
            Ok(enough(&mut width, &mut flown))
        },
    )?;
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
