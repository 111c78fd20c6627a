//! Decides from the findings which law should be in charge.
//!
//! A law is requested once the evidence for its cause has doubled since the cause was named: evidence grows
//! with time, so an error probability of one in fifty becomes one in 2500. Another law is requested only when
//! the size for which the first one was designed is outside the current interval, and never sooner after the
//! last change than the loops' memory (Morse 1996, IEEE Transactions on Automatic Control 41: with such a
//! dwell time, alternating between stable laws is stable) and than ten seconds.

use std::sync::Arc;
use std::thread::{self, JoinHandle};

use whirlstand_msgs::{Finding, FindingStage, Head, text_of};

use super::check::{Better, Check};
use crate::config::{Mode, NodeConfig};
use crate::error::NodeError;
use crate::setup::Setup;
use crate::succession::steps;

/// Shortest time between two changes, s: half of the data from which a cause is identified.
const MOST_OFTEN_S: f64 = 10.0;

/// Longest wait after a cause is withdrawn, s: the length of the data that are analysed.
const LOOKED_AT_S: f64 = 20.0;

/// Bench time of an evaluation in lockstep, s, so that a run is reproducible. In real time it takes its
/// actual time.
const CHECKING_S: f64 = 0.5;

/// Nice value by which the evaluation's priority is below that of the loop.
const NICE: i32 = 10;

/// A law under evaluation.
struct Job {
    cause: Finding,
    due: u64,
    thread: JoinHandle<Result<Better, String>>,
}

/// Decides on changes of the law.
pub(super) struct Laws {
    check: Arc<Check>,
    waits: bool,
    period_ns: u64,
    looked_at: u64,
    checking: u64,
    most_often: u64,
    /// The currently named cause, and the step from which it counts.
    named: Option<(Finding, u64)>,
    /// Step from which the first law should be in charge again.
    back: Option<u64>,
    flying: Option<Finding>,
    /// The cause whose law was evaluated as no better.
    refused: Option<Finding>,
    changed: Option<u64>,
    dwell: u64,
    job: Option<Job>,
}

impl Laws {
    pub(super) fn new(config: &NodeConfig, setup: &Setup) -> Self {
        let check = Check::new(config, setup);
        let most_often = steps(config, MOST_OFTEN_S);
        let dwell = most_often.max(check.memory_s().map_or(0, |s| steps(config, s)));
        Self {
            check: Arc::new(check),
            waits: config.mode == Mode::Lockstep,
            period_ns: config.period_ns,
            looked_at: steps(config, LOOKED_AT_S),
            checking: steps(config, CHECKING_S),
            most_often,
            named: None,
            back: None,
            flying: None,
            refused: None,
            changed: None,
            dwell,
            job: None,
        }
    }

    /// Receives a finding.
    pub(super) fn hear(&mut self, finding: &Finding) {
        let step = finding.head.step;
        let behind = step.saturating_sub(finding.since_ns / self.period_ns);
        match FindingStage::from_u32(finding.stage) {
            Some(FindingStage::Named | FindingStage::Revised) => {
                let before = self.named.take().filter(|(before, _)| is_same_cause(before, finding));
                self.named = Some((*finding, before.map_or(step + behind, |(_, from)| from)));
                self.back = None;
            }
            Some(FindingStage::Withdrawn) => self.give_up(step + behind.min(self.looked_at)),
            Some(FindingStage::Over) => self.give_up(step),
            _ => {}
        }
    }

    fn give_up(&mut self, from: u64) {
        self.named = None;
        self.refused = None;
        self.back = Some(from);
    }

    /// Resets for a new run, under the first law.
    pub(super) fn restart(&mut self) {
        self.give_up(0);
        (self.flying, self.changed, self.job, self.back) = (None, None, None, None);
    }

    /// True when a law that should have been evaluated by this step, for a reproducible run in lockstep, is
    /// still under evaluation. The evaluation runs below the priority of a loop that may keep all processors
    /// busy, so it may take long: the mirror waits without blocking.
    pub(super) fn is_late(&self, step: u64) -> bool {
        self.waits && self.job.as_ref().is_some_and(|job| step >= job.due && !job.thread.is_finished())
    }

    /// Advances to a step; returns a finding to publish, if any.
    ///
    /// # Errors
    /// No thread can be started.
    pub(super) fn turn(&mut self, head: Head) -> Result<Option<Finding>, NodeError> {
        let step = head.step;
        if let Some(job) =
            self.job.take_if(|j| if self.waits { step >= j.due } else { j.thread.is_finished() })
        {
            return Ok(self.judged(job, head));
        }
        if self.job.is_some() || self.changed.is_some_and(|at| step < at + self.dwell) {
            return Ok(None);
        }
        if self.back.take_if(|from| step >= *from).is_some()
            && let Some(flying) = self.flying.take()
        {
            self.changed = Some(step);
            return Ok(Some(said(FindingStage::FirstLaw, &flying, head, 0.0)));
        }
        let is_new = |known: &Option<Finding>, cause: &Finding| {
            known.as_ref().is_none_or(|known| !covers(known, cause))
        };
        if let Some((cause, from)) = &self.named
            && step >= *from
            && is_new(&self.flying, cause)
            && is_new(&self.refused, cause)
        {
            self.job = Some(self.begin(*cause, step)?);
        }
        Ok(None)
    }

    fn begin(&self, cause: Finding, step: u64) -> Result<Job, NodeError> {
        let (check, flying) = (Arc::clone(&self.check), self.flying);
        let work = move || {
            // Without that permission, it competes with this node.
            let _ = rustix::process::setpriority_process(None, NICE);
            check.compare(flying.as_ref(), &cause)
        };
        let thread = thread::Builder::new()
            .name("law".into())
            .spawn(work)
            .map_err(|source| NodeError::System { action: "start the thread that judges laws", source })?;
        Ok(Job { cause, due: step + self.checking, thread })
    }

    fn judged(&mut self, job: Job, head: Head) -> Option<Finding> {
        let cause = job.cause;
        let name = text_of(&cause.effect);
        let better = job.thread.join().unwrap_or_else(|_| Err("its check did not finish".into()));
        let still = self.named.as_ref().is_some_and(|(named, _)| is_same_cause(named, &cause));
        match better {
            Ok(_) if !still => None,
            Ok(better) => {
                let memory = (better.memory_s * 1e9 / self.period_ns as f64) as u64;
                self.dwell = self.dwell.max(memory).max(self.most_often);
                (self.flying, self.changed, self.refused) = (Some(cause), Some(head.step), None);
                Some(said(FindingStage::Law, &cause, head, better.ratio))
            }
            Err(why) => {
                tracing::warn!("the law for {name} on {} does not fly: {why}", text_of(&cause.place));
                self.refused = Some(cause);
                None
            }
        }
    }
}

fn said(stage: FindingStage, cause: &Finding, head: Head, ratio: f64) -> Finding {
    Finding { head: Head { seq: 0, ..head }, stage: stage as u32, evidence: ratio, ..*cause }
}

fn is_same_cause(a: &Finding, b: &Finding) -> bool {
    (a.effect, a.place, a.onto, a.names) == (b.effect, b.place, b.onto, b.names)
}

/// True when the earlier size is within the current interval.
fn covers(known: &Finding, now: &Finding) -> bool {
    let count = (now.count as usize).min(now.value.len());
    is_same_cause(known, now)
        && known.count == now.count
        && (0..count).all(|i| (now.low[i]..=now.high[i]).contains(&known.value[i]))
}

#[cfg(test)]
mod tests;
