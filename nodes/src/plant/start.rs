//! The start of a run: the plant waits for the other nodes, and then for the answer to step 0.

use std::time::{Duration, Instant};

use whirlstand_msgs::NodeState;

use super::Plant;
use super::phase::Phase;
use crate::clock::{Clock, Turn};
use crate::error::NodeError;
use crate::os::MonotonicTime;

/// Repetition period of an unanswered step 0.
const REPEAT: Duration = Duration::from_millis(200);

impl Plant {
    /// Waits until every node runs, and publishes step 0.
    pub(super) fn join(&mut self, clock: &mut Clock, until: Instant) -> Result<Turn, NodeError> {
        let now = clock.now();
        self.peers.turn(now)?;
        if self.peers.not_running().next().is_none() {
            let now = Instant::now();
            self.peers.set_state(NodeState::Running);
            self.phase = Phase::Answering { until: now + self.answer_timeout, repeat: now + REPEAT };
            self.advance(clock, false)?;
            return Ok(Turn::Worked);
        }
        if now < until {
            self.tell_wait(now);
            return Ok(Turn::Idle);
        }
        let missing = self.peers.holding_up(now);
        Err(NodeError::PeersAbsent { missing, waited_s: self.start_timeout.as_secs_f64() })
    }

    /// Waits for command 0, with which the loop begins.
    pub(super) fn await_first_answer(
        &mut self,
        clock: &mut Clock,
        until: Instant,
        repeat: Instant,
    ) -> Result<Turn, NodeError> {
        self.take_commands(clock)?;
        if self.gate.is_ready() {
            self.phase = Phase::Looping;
            self.origin = MonotonicTime::now();
            self.began = Some(Instant::now());
            self.latencies.reset();
            if self.step == self.steps {
                return self.begin_ending();
            }
            return Ok(Turn::Worked);
        }
        let now = clock.now();
        if now >= until {
            let rejected = self.gate.rejected();
            return Err(NodeError::NoAnswer { waited_s: self.answer_timeout.as_secs_f64(), rejected });
        }
        if now >= repeat {
            self.tell_wait(now);
            self.simulation.repeat_measurement()?;
            self.phase = Phase::Answering { until, repeat: now + REPEAT };
        }
        self.housekeeping(now)?;
        Ok(Turn::Idle)
    }
}
