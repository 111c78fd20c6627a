//! Requests changes of a running bench in flight, and receives the answers.

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

/// Time after which the bench is joined again: over a network, nodes that were not there yet have addresses by
/// then.
const JOIN_AGAIN: Duration = Duration::from_secs(2);

/// Time after which a request is sent again. A node carries it out only once.
const SEND_AGAIN: Duration = Duration::from_millis(250);

/// Queue length for answers, including those to requests of others.
const DEPTH: usize = 64;

/// Requests all `wanted` changes. The answers come in the same order; a refusal is an answer too.
///
/// # Errors
/// When the bench does not accept such changes, cannot be joined, or does not answer.
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

/// The failure for a bench that does not answer.
pub(super) fn no_answer(card: &BenchCard) -> Failure {
    Failure::Run(format!(
        "bench '{}' did not answer within {} s: its loop has stopped, or the node that should answer is missing",
        card.bench,
        PATIENCE.as_secs()
    ))
}

/// Checks whether a bench accepts a change from outside.
///
/// # Errors
/// The reason why it does not.
pub(super) fn is_open(card: &BenchCard, one: &Wanted) -> Result<(), Failure> {
    let closed = if one.is_for_the_plant() { &card.plant_closed } else { &card.controller_closed };
    let Some(why) = closed else { return Ok(()) };
    let what = if one.is_for_the_plant() { "gust or engine" } else { "setpoint, gain or stick" };
    Err(Failure::Mend(format!("bench '{}' accepts no {what} from outside: {why}", card.bench)))
}

/// Sends the unanswered requests repeatedly, until all are answered or the time is over.
fn converse(
    card: &BenchCard,
    requests: &[Adjustment],
    answers: &mut [Option<Adjustment>],
    until: Instant,
) -> Result<(), Failure> {
    converse_over(&card.join(GUEST)?, requests, answers, until)
}

/// Exchanges requests and answers on a bus that has been joined.
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
