//! Requests from outside to a node: each is handled once and answered.
//!
//! On a bench that is open to requests they are read at every step; on any other only when the node's health
//! is due, so that a sender learns the reason for the refusal without cost for the loop.

use whirlstand_bus::{Bus, Publisher, Subscriber};
use whirlstand_msgs::{Adjustment, AdjustmentKind, AdjustmentVerdict, Head, Message};

use crate::error::NodeError;
use crate::notices::{Notice, say};
use crate::ports::receive;

/// Topic of requests for changes in flight.
pub const ADJUST_TOPIC: &str = "adjust";

/// Queue length for requests.
const DEPTH: usize = 16;

/// Number of requests whose answers are kept, because an unheard answer leads to a repeated request.
const KEPT: usize = 16;

/// Largest number of requests answered in one step; further ones wait for the next.
pub(crate) const MOST_REQUESTS: usize = 8;

/// Receives the requests to one node and answers them.
pub(crate) struct AdjustmentDesk {
    requests: Subscriber<Adjustment>,
    answers: Publisher<Adjustment>,
    business: &'static [AdjustmentKind],
    /// Key of the launch file that allows requests.
    key: &'static str,
    is_open: bool,
    answered: [Adjustment; KEPT],
    oldest: usize,
    /// A refusal that was not logged yet.
    untold: Option<Adjustment>,
    malformed: u64,
}

impl AdjustmentDesk {
    /// Opens the two topics.
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
        // At most the queue's length: a sender without a pause must not delay the step.
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

    /// Answers a request with a verdict, at the step of `head`.
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

    /// Publishes a change that was not requested now, at the step of `head`.
    ///
    /// # Errors
    /// The transport fails.
    pub fn tell(&mut self, change: Adjustment, head: Head) -> Result<(), NodeError> {
        Ok(self.answers.send(&Adjustment { head, ..change })?)
    }

    /// Work between steps: refuses requests on a closed bench, and logs refusals.
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

    /// Number of unreadable requests. Refused requests are no fault of the bench and do not count.
    pub fn malformed(&self) -> u64 {
        self.malformed
    }
}
