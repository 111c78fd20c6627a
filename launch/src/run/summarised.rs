//! A run with its figures, and whether they meet the expectations.

use std::collections::BTreeMap;
use std::path::PathBuf;

use whirlstand_evaluate::expectation::{CheckedExpectation, check};
use whirlstand_evaluate::metrics::{NodeTiming, Timing, latency, total};
use whirlstand_evaluate::{Run, RunSummary};

use whirlstand_nodes::config::{Mode, Role};

use super::one::FinishedRun;
use super::reproducible::reasons_against;
use crate::file::Plan;
use crate::supervisor::{Counts, Ending, HealthTable};

/// A run with its figures.
#[derive(Debug)]
pub(super) struct Summarised {
    /// Name of the variant, or of the bench.
    pub name: String,
    pub variant: Option<String>,
    pub plan: Plan,
    pub ending: Ending,
    pub restarts: Vec<(String, u32)>,
    pub wall_s: f64,
    /// Number of steps of the plant.
    pub steps: u64,
    pub timing: Timing,
    pub figures: Option<RunSummary>,
    /// The recorded run, for the report.
    pub recorded: Option<Run>,
    pub expect: Vec<CheckedExpectation>,
    /// Reasons why another run can leave a different log.
    pub not_reproducible: Vec<String>,
    /// Problems other than broken expectations.
    pub problems: Vec<String>,
    pub log: Option<PathBuf>,
}

impl Summarised {
    /// Whether every expectation held and nothing else went wrong.
    pub fn holds(&self) -> bool {
        self.problems.is_empty() && self.expect.iter().all(|v| v.holds)
    }
}

/// Reads the log of a run and checks its figures against the expectations.
pub(super) fn summarise(variant: Option<&str>, plan: &Plan, ran: FinishedRun) -> Summarised {
    let name = variant.unwrap_or(&plan.name).to_string();
    let mut problems: Vec<String> = ran.residue.into_iter().collect();
    for node in &ran.outcome.killed_at_end {
        problems.push(format!("{node} did not stop when asked and had to be killed"));
    }
    let recorded = ran.log.as_deref().and_then(|log| match Run::open(log, &name, None) {
        Ok(run) => Some(run),
        Err(e) => {
            problems.push(format!("the log cannot be read: {e}"));
            None
        }
    });
    if let Some(run) = &recorded {
        problems.extend(gaps(run, &ran.outcome.health));
    }
    let figures = recorded.as_ref().map(|run| run.figures.clone());
    let restarts: u64 = ran.outcome.restarts.iter().map(|(_, n)| u64::from(*n)).sum();
    let mut timing = figures.as_ref().map_or_else(|| reported(&ran.outcome.health), |f| f.timing.clone());
    // The restarts come from the launcher: in the log, a node that died before its first report leaves no
    // trace.
    timing.restarts = restarts;
    // The same holds for a failsafe that no log holds, since a vehicle behind a bridge has no truth: the
    // plant's health reports it.
    if let Some(plant) = ran.outcome.health.get("plant") {
        let failsafe = plant.failsafe();
        timing.witness_failsafe(failsafe.steps, failsafe.at_end, plant.counts().steps);
    }
    witness_charge(&mut timing, plan, &ran.outcome.health);
    let expect = match ran.outcome.ending {
        // An unfinished run cannot show that anything holds.
        Ending::Complete => check(&plan.expect, &timing, figures.as_ref()),
        _ => Vec::new(),
    };
    let lost_in_lockstep = plan.config.mode == Mode::Lockstep && timing.lost > 0;
    if lost_in_lockstep && !plan.expect.iter().any(|e| e.key == "max_lost") {
        // In lockstep no message can be late. A lost message is a fault of the bus, unless the file allows
        // it.
        problems.push(format!("{} messages were lost in lockstep", timing.lost));
    }
    let not_reproducible = reasons_against(&plan.config, &timing, &ran.outcome.restarts);
    let steps = ran.outcome.health.get("plant").map_or(0, |h| h.counts().steps);
    Summarised {
        name,
        variant: variant.map(Into::into),
        plan: plan.clone(),
        ending: ran.outcome.ending,
        restarts: ran.outcome.restarts,
        wall_s: ran.outcome.wall.as_secs_f64(),
        steps,
        timing,
        figures,
        recorded,
        expect,
        not_reproducible,
        problems,
        log: ran.log,
    }
}

/// Largest time by which a log may end before the run, s: a killed recorder loses what it had not yet
/// written.
const LOG_END_S: f64 = 1.0;

/// The same in steps of a slow loop.
const LOG_END_STEPS: f64 = 4.0;

/// Sentences on what is missing in the log of a run.
fn gaps(run: &Run, health: &HealthTable) -> Vec<String> {
    let mut gaps: Vec<String> = run.holes.iter().map(|hole| hole.to_string()).collect();
    let figures = &run.figures;
    let end_s = health.get("plant").map_or(0.0, |plant| plant.latest.head.step as f64 * figures.period_s);
    if figures.duration_s + LOG_END_S < end_s {
        gaps.push(format!(
            "the log ends at {:.3} s, the run at {end_s:.3} s: the rest could not be written",
            figures.duration_s
        ));
    }
    // The recorder may not hear one of the nodes: one that was at its limit of memory when the recorder was started
    // again, for example.
    let late = LOG_END_S.max(LOG_END_STEPS * figures.period_s);
    for (topic, last_s) in run.ends.iter().filter(|(_, last_s)| last_s + late < figures.duration_s) {
        gaps.push(format!(
            "the log has no {topic} after {last_s:.3} s of {:.3} s: its node ended, or could not reach the recorder",
            figures.duration_s
        ));
    }
    gaps
}

/// Adds who was in charge where the log does not hold it: a bridge reports it with its health, and without a bridge
/// the controller is in charge throughout.
fn witness_charge(timing: &mut Timing, plan: &Plan, health: &HealthTable) {
    let (disarmed, pilot) = match &plan.config.bridge {
        None => (Some(0.0), Some(0.0)),
        Some(bridge) => {
            let role = if bridge.kind.is_vehicle() { Role::Plant } else { Role::Controller };
            health.get(role.name()).and_then(|node| node.charge().shares()).unzip()
        }
    };
    timing.disarmed_share = timing.disarmed_share.or(disarmed);
    timing.pilot_share = timing.pilot_share.or(pilot);
}

/// Timing figures that the nodes reported to the launcher.
fn reported(health: &HealthTable) -> Timing {
    let node = |counts: Counts| NodeTiming {
        steps: counts.steps,
        deadline_misses: counts.deadline_misses,
        lost: counts.lost,
        rejected: counts.rejected,
        restarts: 0,
        latency: latency(&counts.latency, counts.latency_max_ns),
    };
    let nodes: BTreeMap<_, _> = health.iter().map(|(name, h)| (name.to_string(), node(h.counts()))).collect();
    Timing {
        deadline_misses: nodes.get("plant").map_or(0, |p| p.deadline_misses),
        lost: total(nodes.values().map(|n| n.lost)),
        nodes,
        ..Timing::default()
    }
}
