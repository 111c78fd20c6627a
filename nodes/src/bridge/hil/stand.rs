//! A vehicle at rest before the run, until its autopilot flies.

use std::time::{Duration, Instant};

use whirlstand_bridge::autopilot::{Begin, Stage};

use super::Hil;
use crate::clock::Turn;
use crate::error::NodeError;

impl Hil {
    /// Streams the sensors of a vehicle at rest, until the run can begin.
    pub(super) fn stand(&mut self) -> Result<Turn, NodeError> {
        let step = self.next_step()?;
        self.listen();
        if self.at.is_none() {
            return Ok(Turn::Idle);
        }
        let now = Instant::now();
        let since = *self.awaited_to_fly.get_or_insert(now);
        if now >= self.stand_due {
            // No burst after a pause.
            self.stand_due =
                if now >= self.stand_due + self.period { now } else { self.stand_due } + self.period;
            // An autopilot in lockstep gets its next sensors after its answer, or when the answer seems lost.
            let patience = if self.autopilot.is_lockstep() { self.patience } else { Duration::ZERO };
            if self.autopilot.is_answered() || now >= self.sensed_at + patience {
                self.sense(1);
            }
        }
        let ready = match self.flight.begin() {
            Begin::Linked => self.flight.is_fresh(self.now()),
            Begin::Armed => self.flight.is_flying(&self.mixer, self.now()) && self.rc_is_done(),
        };
        if ready {
            tracing::info!("{} flies: the run begins", self.name);
            self.waits.over();
            self.flight.start();
            self.links.begin();
            self.tally.begin(self.autopilot.counts());
            self.answer(self.at.map_or(0, |at| at.step))?;
        }
        if !ready {
            let (name, fresh, links) = (self.name, self.flight.is_fresh(self.now()), &self.links);
            if self.waits.tell(now, fresh, self.autopilot.said(), || links.place()) {
                tracing::warn!(
                    "{name} is connected, is not armed, and has not said why: {}",
                    self.autopilot.advice()
                );
            }
            if !self.flight.is_flying(&self.mixer, self.now()) && self.rc.retry(self.now()) {
                tracing::warn!("{name} was not armed by its switch; the switch is set off and on again");
            }
            if now >= since + self.start_timeout {
                return Err(self.never_flew());
            }
        }
        Ok(if step.is_some() || ready { Turn::Worked } else { Turn::Idle })
    }

    /// Error for an autopilot that did not fly in time.
    fn never_flew(&self) -> NodeError {
        let (name, waited_s, counts) = (self.name, self.start_timeout.as_secs_f64(), self.autopilot.counts());
        if counts.outputs == 0 {
            return NodeError::NoAutopilot { name, waited_s, malformed: counts.malformed };
        }
        NodeError::not_armed(name, waited_s, self.autopilot.said(), &self.autopilot.advice())
    }

    /// True when the throttle is up, where this bridge controls it.
    fn rc_is_done(&self) -> bool {
        matches!(self.rc.stage(), Stage::Off | Stage::Flying)
    }
}
