//! Manual control by a viewer: the viewer's stick positions go to the controller until the viewer is silent or the
//! bench reports that the law has control again.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_live::Answer;
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, MAX_INPUTS, Message, Stick};
use whirlstand_vehicle::Vehicle;

use super::ask::{PATIENCE, converse_over, is_open, no_answer};
use super::card::BenchCard;
use super::told::Told;
use super::wanted::Wanted;
use crate::error::Failure;
use crate::keys::GUEST;

/// Longest silence of a viewer before the thread of its hand ends. The controller takes the stick back much
/// earlier.
const SILENCE: Duration = Duration::from_secs(2);

/// Queue length for the answers of the bench, including those to requests of others.
const DEPTH: usize = 64;

/// The hand of one viewer on the stick, and the thread that sends its positions.
struct Hand {
    id: u64,
    moves: SyncSender<[f64; MAX_INPUTS]>,
}

/// The hand that holds the stick, if any.
#[derive(Default)]
pub(super) struct Hands(Mutex<Option<Hand>>);

impl Hands {
    /// Takes the stick over under the number `id`, which the viewer chose and no other request has.
    pub fn take(&self, card: &BenchCard, vehicle: &Vehicle, id: u64) -> Answer {
        let wanted = Wanted::Stick(Some(id));
        is_open(card, &wanted).map_err(|e| e.to_string())?;
        let (moves, said) = sync_channel(1);
        let (tell, told) = sync_channel(1);
        let bench = card.clone();
        let body = move || match open(&bench, &wanted) {
            Ok((held, answer)) => {
                let is_ours = answer.verdict == AdjustmentVerdict::Done as u32;
                // The viewer that asked may have left.
                let _ = tell.send(Ok(answer));
                if is_ours && let Err(e) = held.hold(id, &said) {
                    tracing::warn!("the stick is released: {e}");
                }
            }
            Err(e) => {
                let _ = tell.send(Err(e.to_string()));
            }
        };
        std::thread::Builder::new().name("stick".into()).spawn(body).map_err(|e| e.to_string())?;
        let answer = told.recv().map_err(|_| "the stick cannot be taken over".to_string())??;
        let told = Told::new(&wanted, &answer, vehicle);
        if told.refused.is_some() {
            return Err(told.sentence());
        }
        *self.hand() = Some(Hand { id, moves });
        Ok(told.sentence())
    }

    /// Sets the inputs that the hand commands, SI.
    pub fn say(&self, id: u64, u: [f64; MAX_INPUTS]) -> Answer {
        let hand = self.hand();
        let own = hand.as_ref().filter(|hand| hand.id == id);
        // A position is left out while an earlier one waits: the next one is newer.
        match own.map(|own| own.moves.try_send(u)) {
            Some(Ok(()) | Err(TrySendError::Full(_))) => Ok(String::new()),
            _ => Err("you do not have the stick: the law or somebody else is flying".into()),
        }
    }

    /// Gives the stick back.
    pub fn give(&self, id: u64) {
        self.hand().take_if(|hand| hand.id == id);
    }

    fn hand(&self) -> MutexGuard<'_, Option<Hand>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A stick that was requested from the bench.
struct Held {
    _bus: Bus,
    publisher: whirlstand_bus::Publisher<Stick>,
    heard: Subscriber<Adjustment>,
}

/// Joins the bench and requests its stick. All ports are opened before that, since the bench begins to wait for
/// positions with its answer.
fn open(card: &BenchCard, wanted: &Wanted) -> Result<(Held, Adjustment), Failure> {
    let bus = card.join(GUEST)?;
    let publisher = bus.publisher().map_err(Failure::mend)?;
    let heard = bus.subscriber(DEPTH).map_err(Failure::mend)?;
    let mut answers = [None];
    converse_over(&bus, &[wanted.request()], &mut answers, Instant::now() + PATIENCE)?;
    let answer = answers[0].ok_or_else(|| no_answer(card))?;
    Ok((Held { _bus: bus, publisher, heard }, answer))
}

impl Held {
    /// Sends the hand's positions until the hand is silent or the bench reports that the law has control.
    fn hold(mut self, id: u64, said: &Receiver<[f64; MAX_INPUTS]>) -> Result<(), Failure> {
        while let Ok(u) = said.recv_timeout(SILENCE) {
            self.publisher.send(&Stick { u, id, ..Stick::zeroed() }).map_err(Failure::run)?;
            while let Some(m) = self.heard.try_recv().map_err(Failure::run)? {
                let is_done = m.verdict == AdjustmentVerdict::Done as u32;
                if is_done && m.what == AdjustmentKind::Stick as u32 && m.value == 0.0 {
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}
