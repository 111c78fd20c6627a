//! Where a node takes requests from outside: those that are its business, each once, each answered.
//!
//! On a bench that is open to them they are looked for at every step; on any other only when the node's health is due, so
//! that whoever asks learns why nothing happens and the loop pays nothing for it.

use whirlstand_bus::{Bus, Publisher, Subscriber};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, Head, Message};

use crate::error::NodeError;
use crate::notices::{Notice, say};
use crate::ports::receive;

/// Topic on which changes in flight are asked for.
pub const ADJUST_TOPIC: &str = "adjust";

/// Queue for requests.
const DEPTH: usize = 16;

/// Requests whose answers are kept, because one that was not heard is asked again.
const KEPT: usize = 16;

/// Requests that are answered in one step; more wait for the next.
pub(crate) const MOST_REQUESTS: usize = 8;

/// The requests to one node.
pub(crate) struct AdjustmentDesk {
    requests: Subscriber<Adjustment>,
    answers: Publisher<Adjustment>,
    business: &'static [AdjustmentKind],
    /// Key of the launch file that opens it.
    key: &'static str,
    is_open: bool,
    answered: [Adjustment; KEPT],
    oldest: usize,
    /// A refusal that the log was not told of yet.
    untold: Option<Adjustment>,
    malformed: u64,
}

impl AdjustmentDesk {
    /// Joins the two topics.
    ///
    /// # Errors
    /// The ports cannot be opened.
    pub fn open(
        bus: &Bus,
        business: &'static [AdjustmentKind],
        key: &'static str,
        is_open: bool,
    ) -> Result<Self, NodeError> {
        Ok(Self {
            requests: bus.subscriber_on(ADJUST_TOPIC, DEPTH)?,
            answers: bus.publisher()?,
            business,
            key,
            is_open,
            answered: [Adjustment::zeroed(); KEPT],
            oldest: 0,
            untold: None,
            malformed: 0,
        })
    }

    /// The next request, on a bench that is open to requests.
    ///
    /// # Errors
    /// The transport fails.
    #[inline]
    pub fn next(&mut self) -> Result<Option<(AdjustmentKind, Adjustment)>, NodeError> {
        if self.is_open { self.receive() } else { Ok(None) }
    }

    fn receive(&mut self) -> Result<Option<(AdjustmentKind, Adjustment)>, NodeError> {
        // No more than waits: whoever asks without a pause does not keep the step from being taken.
        for _ in 0..DEPTH {
            let Some(request) = receive(&mut self.requests, &mut self.malformed)? else { break };
            let kind = AdjustmentKind::from_u32(request.what).filter(|kind| self.business.contains(kind));
            let Some(kind) = kind else { continue };
            let done = |a: &&Adjustment| a.id == request.id && a.verdict != AdjustmentVerdict::Asked as u32;
            match self.answered.iter().find(done).copied() {
                Some(answer) => self.answers.send_again(&answer)?,
                None => return Ok(Some((kind, request))),
            }
        }
        Ok(None)
    }

    /// Says what became of a request, at the step of `head`.
    ///
    /// # Errors
    /// The transport fails.
    pub fn answer(
        &mut self,
        request: &Adjustment,
        head: Head,
        verdict: AdjustmentVerdict,
    ) -> Result<(), NodeError> {
        let answer = Adjustment { head, verdict: verdict as u32, ..*request };
        if verdict != AdjustmentVerdict::Done {
            self.untold = Some(answer);
        }
        self.answered[self.oldest] = answer;
        self.oldest = (self.oldest + 1) % KEPT;
        Ok(self.answers.send(&answer)?)
    }

    /// Says what nobody asked for now, at the step of `head`.
    ///
    /// # Errors
    /// The transport fails.
    pub fn tell(&mut self, change: Adjustment, head: Head) -> Result<(), NodeError> {
        Ok(self.answers.send(&Adjustment { head, ..change })?)
    }

    /// What is done between steps: refuses what came to a bench that is closed, and tells the log of refusals.
    ///
    /// # Errors
    /// The transport fails.
    pub fn attend(&mut self, head: Head) -> Result<(), NodeError> {
        for _ in 0..MOST_REQUESTS {
            let Some((_, request)) = (if self.is_open { None } else { self.receive()? }) else { break };
            self.answer(&request, head, AdjustmentVerdict::Closed)?;
        }
        let Some(answer) = self.untold.take() else { return Ok(()) };
        say(Notice::Refused { answer, key: self.key });
        Ok(())
    }

    /// Requests that could not be read. What was asked for and refused is no fault of the bench.
    pub fn malformed(&self) -> u64 {
        self.malformed
    }
}
