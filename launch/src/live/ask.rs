//! Asks a running bench for changes in flight, and hears what became of them.

use std::time::{Duration, Instant};

use whirlstand_bus::Bus;
use whirlstand_msgs::{Adjustment, AdjustmentVerdict};
use whirlstand_nodes::ADJUST_TOPIC;

use super::card::BenchCard;
use super::wanted::Wanted;
use crate::error::Failure;
use crate::keys::GUEST;

/// Longest wait for all answers.
pub(super) const PATIENCE: Duration = Duration::from_secs(10);

/// Time after which the bench is joined anew: over a network, nodes that were not there yet have addresses by then.
const JOIN_AGAIN: Duration = Duration::from_secs(2);

/// Time after which a request is sent once more; a node does it once all the same.
const SEND_AGAIN: Duration = Duration::from_millis(250);

/// Queue for answers, of others' requests too.
const DEPTH: usize = 64;

/// Asks for all that is wanted; the answers are in the same order. What a node refuses is an answer as well.
///
/// # Errors
/// When the bench takes nothing of the kind, cannot be joined, or does not answer.
pub(crate) fn ask(card: &BenchCard, wanted: &[Wanted]) -> Result<Vec<Adjustment>, Failure> {
    wanted.iter().try_for_each(|one| is_open(card, one))?;
    let requests: Vec<_> = wanted.iter().map(Wanted::request).collect();
    let mut answers = vec![None; requests.len()];
    let until = Instant::now() + PATIENCE;
    while answers.contains(&None) && Instant::now() < until {
        converse(card, &requests, &mut answers, until.min(Instant::now() + JOIN_AGAIN))?;
    }
    let heard: Option<Vec<_>> = answers.into_iter().collect();
    heard.ok_or_else(|| no_answer(card))
}

/// Nobody has answered.
pub(super) fn no_answer(card: &BenchCard) -> Failure {
    Failure::Run(format!(
        "bench '{}' did not answer within {} s: its loop has stopped, or the node that should answer is missing",
        card.bench,
        PATIENCE.as_secs()
    ))
}

/// Whether a bench takes a change from outside.
///
/// # Errors
/// Why it does not.
pub(super) fn is_open(card: &BenchCard, one: &Wanted) -> Result<(), Failure> {
    let closed = if one.is_for_the_plant() { &card.plant_closed } else { &card.controller_closed };
    let Some(why) = closed else { return Ok(()) };
    let what = if one.is_for_the_plant() { "gust or engine" } else { "setpoint, gain or stick" };
    Err(Failure::Mend(format!("bench '{}' accepts no {what} from outside: {why}", card.bench)))
}

/// Sends what is not answered yet, again and again, until all is answered or the time is over.
fn converse(
    card: &BenchCard,
    requests: &[Adjustment],
    answers: &mut [Option<Adjustment>],
    until: Instant,
) -> Result<(), Failure> {
    converse_over(&card.join(GUEST)?, requests, answers, until)
}

/// The same on a bus that was joined.
///
/// # Errors
/// When the transport fails.
pub(super) fn converse_over(
    bus: &Bus,
    requests: &[Adjustment],
    answers: &mut [Option<Adjustment>],
    until: Instant,
) -> Result<(), Failure> {
    let mut heard = bus.subscriber::<Adjustment>(DEPTH).map_err(Failure::mend)?;
    let mut publisher = bus.publisher_on::<Adjustment>(ADJUST_TOPIC).map_err(Failure::mend)?;
    while answers.contains(&None) && Instant::now() < until {
        for (request, _) in requests.iter().zip(&*answers).filter(|(_, answer)| answer.is_none()) {
            publisher.send(request).map_err(Failure::run)?;
        }
        let look = until.min(Instant::now() + SEND_AGAIN);
        bus.wait_until(look, || {
            while let Some(answer) = heard.try_recv()? {
                if answer.verdict == AdjustmentVerdict::Asked as u32 {
                    continue;
                }
                let asked = requests.iter().position(|r| r.id == answer.id && r.what == answer.what);
                if let Some(slot) = asked.and_then(|i| answers.get_mut(i)) {
                    *slot = Some(answer);
                }
            }
            Ok::<_, whirlstand_bus::RecvError>(!answers.contains(&None))
        })
        .map_err(Failure::run)?;
    }
    Ok(())
}
