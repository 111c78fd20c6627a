//! Which law should fly, by what has been found.
//!
//! A law is asked for once the evidence behind its cause has doubled since that was named: information comes with time, so what was
//! wrong once in fifty then is wrong once in 2500 now. It is asked for again only when the size that it was designed for is outside of the interval that is
//! known, and never sooner after the last change than the loops remember (Morse 1996, IEEE Transactions on Automatic Control 41: with
//! such a dwell time, laws that are stable one by one are stable however they take turns) and than ten seconds.

use std::sync::Arc;
use std::thread::{self, JoinHandle};

use whirlstand_msgs::{Finding, FindingStage, Head, text_of};

use super::check::{Better, Check};
use crate::config::{Mode, NodeConfig};
use crate::error::NodeError;
use crate::setup::Setup;
use crate::succession::steps;

/// Shortest time between two changes, s: half of the data that a cause is looked for in.
const MOST_OFTEN_S: f64 = 10.0;

/// A cause that does not hold is waited for no longer than so much data is looked at, s.
const LOOKED_AT_S: f64 = 20.0;

/// Bench time that a check takes in lockstep, s, so that a run repeats itself. In real time it takes what it takes.
const CHECKING_S: f64 = 0.5;

/// How much lower than the loop's the check's priority is.
const NICE: i32 = 10;

/// A law that is being judged.
struct Job {
    cause: Finding,
    due: u64,
    thread: JoinHandle<Result<Better, String>>,
}

/// Decides on laws.
pub(super) struct Laws {
    check: Arc<Check>,
    waits: bool,
    period_ns: u64,
    looked_at: u64,
    checking: u64,
    most_often: u64,
    /// The cause that is named now, and from which step on it counts.
    named: Option<(Finding, u64)>,
    /// From which step on the first law should fly.
    back: Option<u64>,
    flying: Option<Finding>,
    /// The cause for which the law was judged no better.
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

    /// What was found.
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

    /// The plant began a new run, under the first law.
    pub(super) fn restart(&mut self) {
        self.give_up(0);
        (self.flying, self.changed, self.job, self.back) = (None, None, None, None);
    }

    /// Whether a law that should have been judged by this step, so that a run in lockstep repeats itself, is still being judged.
    /// The check runs below the priority of a loop that may keep all processors busy, so it may take long: the mirror waits
    /// without standing still.
    pub(super) fn is_late(&self, step: u64) -> bool {
        self.waits && self.job.as_ref().is_some_and(|job| step >= job.due && !job.thread.is_finished())
    }

    /// Goes on; what there is to say at a step, if anything.
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
            // Where it may not, it competes as this node does.
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

/// Whether the size that was known lies within what is known now.
fn covers(known: &Finding, now: &Finding) -> bool {
    let count = (now.count as usize).min(now.value.len());
    is_same_cause(known, now)
        && known.count == now.count
        && (0..count).all(|i| (now.low[i]..=now.high[i]).contains(&known.value[i]))
}

#[cfg(test)]
mod tests;
