//! Flies a campaign until all flights are flown, enough is known, or a signal arrives.

use std::collections::BTreeMap;

use indicatif::ProgressBar;
use whirlstand_campaign::{Flight, Proportion};
use whirlstand_nodes::flight::LANES;

use super::flyer::Flyer;
use super::journal::Journal;
use super::side_by_side::side_by_side;
use crate::error::Failure;

/// Flights between two checks whether enough is known. Only the flights up to the first missing number count, so
/// that the end does not depend on which thread was faster.
const BATCH: usize = 64;

/// The flights that are known when the campaign ends.
pub(super) struct Flown {
    /// The flights by number.
    pub flights: BTreeMap<u64, Flight>,
    /// Number of flights of the campaign where it ended early because enough was known.
    pub enough: Option<u64>,
    /// Whether a signal ended the campaign.
    pub interrupted: bool,
}

/// Flies `numbers` in addition to the flights in `done`.
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
    // As many flights in a group as fly side by side, or fewer, so that every thread has work.
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

/// The stopping rule: the campaign ends when the confidence interval of the share of failed flights is at
/// most `width` wide.
struct Width {
    width: f64,
    /// Flights up to the first missing number, and how many of them failed.
    seen: u64,
    broken: u64,
    next: u64,
}

/// Whether the finished flights suffice.
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
