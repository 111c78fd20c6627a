//! Inputs of the controller from outside the loop: a pilot's setpoints on `pilot`, single setpoints and the
//! gain on `adjust`, and manual control on `stick`.

use whirlstand_bus::{Bus, Subscriber};
use whirlstand_msgs::{
    Adjustment, AdjustmentKind, AdjustmentVerdict, Head, MAX_INPUTS, MAX_STATES, Message, Setpoint,
};

use super::hand::Hand;
use super::law::Law;
use crate::adjustment_desk::{AdjustmentDesk, MOST_REQUESTS};
use crate::config::NodeConfig;
use crate::error::NodeError;
use crate::gate::InputLimits;
use crate::ports::receive;

/// Topic on which a pilot or planner outside the loop sets the reference.
pub const PILOT_TOPIC: &str = "pilot";

/// Queue length for a pilot's setpoints.
const PILOT_DEPTH: usize = 64;

pub(super) struct Outside {
    pilot: Option<Subscriber<Setpoint>>,
    desk: AdjustmentDesk,
    hand: Option<Hand>,
    piloted: Option<Setpoint>,
    /// References set by single requests, and which states have one.
    reference: [f64; MAX_STATES],
    set: u64,
    /// Reference that the controller tracks with these.
    combined: Setpoint,
    /// Bounds of the states, SI.
    bounds: Vec<f64>,
    refused: u64,
}

impl Outside {
    pub(super) fn open(
        bus: &Bus,
        config: &NodeConfig,
        bounds: Vec<f64>,
        limits: InputLimits,
    ) -> Result<Self, NodeError> {
        let is_open = config.controller.pilot;
        let business = &[AdjustmentKind::Setpoint, AdjustmentKind::Gain, AdjustmentKind::Stick];
        Ok(Self {
            pilot: if is_open { Some(bus.subscriber_on(PILOT_TOPIC, PILOT_DEPTH)?) } else { None },
            desk: AdjustmentDesk::open(bus, business, "controller.pilot", is_open)?,
            hand: is_open.then(|| Hand::open(bus, config, limits)).transpose()?,
            piloted: None,
            reference: [0.0; MAX_STATES],
            set: 0,
            combined: Setpoint::zeroed(),
            bounds,
            refused: 0,
        })
    }

    /// Receives waiting messages, for the step of `head` and all later ones; `before` is the last command.
    pub(super) fn take(
        &mut self,
        head: Head,
        law: &mut Law,
        before: &[f64; MAX_INPUTS],
    ) -> Result<(), NodeError> {
        let Some(pilot) = &mut self.pilot else { return Ok(()) };
        // At most the queue's length: a sender without a pause must not delay the step.
        for _ in 0..PILOT_DEPTH {
            let Some(setpoint) = receive(pilot, &mut self.refused)? else { break };
            if setpoint.x.iter().chain(&setpoint.stick).all(|v| v.is_finite()) {
                self.piloted = Some(setpoint);
            } else {
                self.refused += 1;
            }
        }
        for _ in 0..MOST_REQUESTS {
            let Some((kind, request)) = self.desk.next()? else { break };
            let verdict = match kind {
                AdjustmentKind::Gain => law.adjust_gain(request.value),
                AdjustmentKind::Stick => match &mut self.hand {
                    Some(hand) => hand.adjust(&request, head.step, before),
                    None => AdjustmentVerdict::Closed,
                },
                _ => self.set_reference(&request),
            };
            self.desk.answer(&request, head, verdict)?;
        }
        if let Some(hand) = &mut self.hand
            && let Some(let_go) = hand.take(head.step, &mut self.refused)?
        {
            self.desk.tell(let_go, head)?;
        }
        Ok(())
    }

    /// Manual inputs that replace the law's, if any.
    pub(super) fn hand(&self) -> Option<&[f64; MAX_INPUTS]> {
        self.hand.as_ref().and_then(Hand::u)
    }

    /// Reference that the controller tracks, based on that of the launch file.
    pub(super) fn setpoint<'a>(&'a mut self, planned: &'a Setpoint) -> &'a Setpoint {
        let by_hand = self.hand().copied();
        if self.piloted.is_none() && self.set == 0 && by_hand.is_none() {
            return planned;
        }
        self.combined = self.piloted.unwrap_or(*planned);
        self.combined.head = planned.head;
        self.combined.tracked |= self.set;
        for (i, wanted) in self.combined.x.iter_mut().enumerate() {
            if self.set >> i & 1 == 1 {
                *wanted = self.reference[i];
            }
        }
        if let Some(u) = by_hand {
            self.combined.stick = u;
        }
        &self.combined
    }

    /// Resets for a new run, in which nothing has been requested yet. A pilot's stick keeps its position.
    pub(super) fn forget(&mut self) {
        self.set = 0;
        if let Some(hand) = &mut self.hand {
            hand.forget();
        }
    }

    /// Work between steps, see [`AdjustmentDesk::attend`].
    pub(super) fn attend(&mut self, head: Head) -> Result<(), NodeError> {
        self.desk.attend(head)
    }

    /// Number of unusable messages from outside.
    pub(super) fn refused(&self) -> u64 {
        self.refused + self.desk.malformed()
    }

    fn set_reference(&mut self, request: &Adjustment) -> AdjustmentVerdict {
        let state = request.index as usize;
        let Some(bound) = self.bounds.get(state) else { return AdjustmentVerdict::NoSuchState };
        if !request.value.is_finite() {
            return AdjustmentVerdict::Unusable;
        }
        if request.value.abs() > *bound {
            return AdjustmentVerdict::OutOfRange;
        }
        self.reference[state] = request.value;
        self.set |= 1 << state;
        AdjustmentVerdict::Done
    }
}
