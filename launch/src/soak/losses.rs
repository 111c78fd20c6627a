//! The losses that a fault may cause, and the losses beyond them.
//!
//! | fault | may cause the loss of |
//! |---|---|
//! | kill, stop, memory | messages of the target node, while that node is away |
//! | disk | messages of the log, each counted by the recorder and reported in the log as part of a hole |
//! | forge, flood, load | nothing: every step is in the log, and in lockstep every message arrives |
//!
//! In real time a command that a late plant did not read in time is a deadline miss, and not a loss: the gate
//! would refuse it. The number of misses is shown, and judged by the recovery.

use std::path::Path;

use whirlstand_logs::{BenchMessage, Hole, Log, ReadError};
use whirlstand_nodes::config::{Mode, Role};

use super::fault::FORGED;
use crate::cli::FaultArg;
use crate::supervisor::Outcome;

/// Losses and forgeries in the log of a soak.
#[derive(Debug, Default, PartialEq)]
pub(super) struct LogCheck {
    messages: u64,
    /// Messages that the log reports as missing.
    told: u64,
    /// Missing steps of the plant that no hole reports.
    untold: u64,
    /// Number of messages with the mark of a forgery.
    forged: u64,
}

impl LogCheck {
    /// Reads all files of a log.
    pub fn of(path: &Path) -> Result<Self, ReadError> {
        let log = Log::open(path)?;
        let mut messages = log.bench_messages()?;
        let mut check = Self::default();
        let mut steps = Vec::new();
        for message in &mut messages {
            let message = message?;
            check.messages += 1;
            match message {
                BenchMessage::Truth(truth) => {
                    check.forged += u64::from(truth.x[0] == FORGED);
                    steps.push((truth.head.step, truth.head.stamp_ns));
                }
                BenchMessage::Command(command) => check.forged += u64::from(command.u[0] == FORGED),
                _ => {}
            }
        }
        let holes = messages.holes();
        check.told = holes.iter().map(|hole| hole.messages).sum();
        check.untold = untold(&steps, &holes);
        Ok(check)
    }
}

/// Number of steps that are missing between two steps of a run and that no hole covers; `steps` holds step and
/// time in the order of the log.
fn untold(steps: &[(u64, u64)], holes: &[Hole]) -> u64 {
    let missing = |pair: &[(u64, u64)]| {
        let [(before, from_ns), (after, until_ns)] = pair else { return 0 };
        // A step that is not later than the one before begins another run.
        let missing = after.saturating_sub(before + 1);
        let told = holes.iter().any(|hole| hole.from_ns <= *until_ns && *from_ns <= hole.until_ns);
        if told { 0 } else { missing }
    };
    steps.windows(2).map(missing).sum()
}

/// Sentences on the losses that the fault must not cause.
pub(super) fn losses(
    (fault, mode): (FaultArg, Mode),
    outcome: &Outcome,
    log: Option<&Path>,
    forged: u64,
) -> Vec<String> {
    let mut problems = Vec::new();
    let check = match log.map(LogCheck::of) {
        None => LogCheck { messages: 1, ..LogCheck::default() },
        Some(Ok(check)) => check,
        Some(Err(e)) => return vec![format!("the log cannot be read: {e}")],
    };
    if check.messages == 0 {
        problems.push("the log is empty".into());
    }
    if forged + check.forged > 0 {
        problems.push(format!(
            "forged messages were accepted: {forged} reached the launcher, {} are in the log",
            check.forged
        ));
    }
    if matches!(fault, FaultArg::Kill | FaultArg::Stop | FaultArg::Memory) {
        return problems;
    }
    if check.untold > 0 {
        problems
            .push(format!("{} steps are missing from the log, and it does not report them", check.untold));
    }
    if fault == FaultArg::Disk && check.told == 0 {
        problems.push("the recorder could always write: make the faults longer with --lasting".into());
    }
    let recorder = Role::Recorder.name();
    for (node, health) in outcome.health.iter() {
        let lost = health.counts().lost;
        if fault == FaultArg::Disk && node == recorder {
            if lost != check.told {
                let told = check.told;
                problems.push(format!("{node} lost {lost} messages, but the log reports {told}"));
            }
        } else if lost > 0 && (mode == Mode::Lockstep || node == recorder) {
            problems.push(format!("{node} lost {lost} messages"));
        }
    }
    let restarted =
        outcome.restarts.iter().map(|(node, times)| format!("{node} was restarted {times} times"));
    problems.extend(restarted);
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_step_is_told_by_a_hole_or_is_a_loss() {
        let steps = |numbers: &[u64]| numbers.iter().map(|&k| (k, 10 * k)).collect::<Vec<_>>();
        let hole = Hole { from_ns: 40, until_ns: 80, messages: 9, reason: "disk full".into() };
        assert_eq!(untold(&steps(&[0, 1, 2, 3]), &[]), 0);
        assert_eq!(untold(&steps(&[0, 1, 5, 6]), &[]), 3);
        assert_eq!(untold(&steps(&[3, 4, 9]), std::slice::from_ref(&hole)), 0);
        assert_eq!(untold(&steps(&[0, 2, 4, 9]), &[hole]), 1);
        assert_eq!(untold(&steps(&[7, 8, 0, 1]), &[]), 0, "a plant that was started again");
    }
}
