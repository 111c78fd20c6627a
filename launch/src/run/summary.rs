//! What a run leaves behind as figures: `summary.json` and `report.html`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use whirlstand_ident::metrics::{NodeTiming, Timing, latency};
use whirlstand_ident::report::{Expected, Outcome};
use whirlstand_ident::summary::SUMMARY_SCHEMA;
use whirlstand_ident::{Run, RunSummary};

use super::one::Ran;
use crate::error::Failure;
use crate::file::{Expectation, Figure, Jobs, Plan, Verdict, judge};
use crate::supervisor::{Ending, HealthBook};

/// `summary.json`.
#[derive(Debug, Serialize)]
pub(super) struct Whole {
    schema: &'static str,
    bench: String,
    description: String,
    version: &'static str,
    /// The verdict in a sentence.
    verdict: String,
    /// Every run was complete and every expectation held.
    ok: bool,
    /// Counts over all runs.
    timing: Totals,
    runs: Vec<OfRun>,
}

#[derive(Debug, Serialize)]
struct Totals {
    steps: u64,
    wall_s: f64,
    deadline_misses: u64,
    held_steps: u64,
    failsafe_steps: u64,
    lost: u64,
    restarts: u64,
}

/// One run in `summary.json`: how it ended, then the figures of its log.
#[derive(Debug, Serialize)]
struct OfRun {
    variant: Option<String>,
    ended: Ended,
    /// Rate of the loop that was asked for, Hz.
    rate_hz: f64,
    law: serde_json::Value,
    steps: u64,
    wall_s: f64,
    steps_per_s: f64,
    expect: Vec<Verdict>,
    problems: Vec<String>,
    /// Figures from the log; null for a run without one.
    #[serde(flatten)]
    figures: Option<RunSummary>,
    /// Timing figures of a run without a log, as its nodes reported them.
    #[serde(skip_serializing_if = "Option::is_none", rename = "timing")]
    reported: Option<Timing>,
}

#[derive(Debug, Serialize)]
struct Ended {
    /// `complete`, `interrupted` or `failed`.
    how: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    signal: Option<i32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    node: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    why: Option<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    last_words: Vec<String>,
    restarts: BTreeMap<String, u32>,
}

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
    /// Steps that the plant did.
    pub steps: u64,
    pub timing: Timing,
    pub figures: Option<RunSummary>,
    /// The recorded run, for the report.
    pub recorded: Option<Run>,
    pub expect: Vec<Verdict>,
    /// What else went wrong.
    pub problems: Vec<String>,
    pub log: Option<PathBuf>,
}

impl Summarised {
    /// Whether every expectation held and nothing else went wrong.
    pub fn holds(&self) -> bool {
        self.problems.is_empty() && self.expect.iter().all(|v| v.holds)
    }
}

/// Reads the log of a run and holds its figures against the expectations.
pub(super) fn summarise(variant: Option<&str>, plan: &Plan, ran: Ran) -> Summarised {
    let name = variant.unwrap_or(&plan.name).to_string();
    let mut problems: Vec<String> = ran.residue.into_iter().collect();
    for node in &ran.outcome.killed_at_end {
        problems.push(format!("{node} did not end when it was asked and had to be killed"));
    }
    let recorded = ran.log.as_deref().and_then(|log| match Run::open(log, &name, None) {
        Ok(run) => Some(run),
        Err(e) => {
            problems.push(format!("the log cannot be read: {e}"));
            None
        }
    });
    let figures = recorded.as_ref().map(RunSummary::of);
    let restarts: u64 = ran.outcome.restarts.iter().map(|(_, n)| u64::from(*n)).sum();
    let mut timing = figures.as_ref().map_or_else(|| reported(&ran.outcome.health), |f| f.timing.clone());
    // The launcher knows; from the log alone, a node that died before its first report leaves no trace.
    timing.restarts = restarts;
    let expect = match ran.outcome.ending {
        // An unfinished run cannot show that anything holds.
        Ending::Complete => judge(&plan.expect, &measured(&plan.expect, &timing, figures.as_ref())),
        _ => Vec::new(),
    };
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
        problems,
        log: ran.log,
    }
}

/// Timing figures as the nodes reported them to the launcher.
fn reported(health: &HealthBook) -> Timing {
    let node = |counts: crate::supervisor::Counts| NodeTiming {
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
        lost: nodes.values().map(|n| n.lost).sum(),
        nodes,
        ..Timing::default()
    }
}

/// The figures that are expected something of.
fn measured(
    expect: &[Expectation],
    timing: &Timing,
    figures: Option<&RunSummary>,
) -> BTreeMap<String, Figure> {
    let plant = timing.nodes.get("plant").and_then(|p| p.latency);
    let find = |key: &str| match key {
        "max_deadline_misses" => Some(Figure::Value(timing.deadline_misses as f64)),
        "max_lost" => Some(Figure::Value(timing.lost as f64)),
        "max_restarts" => Some(Figure::Value(timing.restarts as f64)),
        "max_rejected" => Some(Figure::Value(timing.nodes.values().map(|n| n.rejected).sum::<u64>() as f64)),
        "max_latency_p99_s" => plant.map(|l| Figure::Value(l.p99_us * 1e-6)),
        "max_latency_s" => plant.map(|l| Figure::Value(l.max_us * 1e-6)),
        key => match figures?.figure(key)? {
            whirlstand_ident::Figure::Value(value) => Some(Figure::Value(value)),
            whirlstand_ident::Figure::Never => Some(Figure::Never),
            whirlstand_ident::Figure::NoEvent => None,
        },
    };
    expect.iter().filter_map(|e| Some((e.key.clone(), find(&e.key)?))).collect()
}

/// Writes `summary.json` and `report.html` into `out`; returns the summary.
pub(super) fn write(jobs: &Jobs, out: &Path, runs: &[Summarised]) -> Result<Whole, Failure> {
    let whole = whole(jobs, runs);
    crate::command::write_json(&whole, &out.join("summary.json"))?;
    let recorded: Vec<&Run> = runs.iter().filter_map(|r| r.recorded.as_ref()).collect();
    if !recorded.is_empty() {
        let outcome = outcome(&whole, runs);
        let html = whirlstand_ident::report::run_report(&jobs.name, &jobs.description, &outcome, &recorded)
            .map_err(|e| Failure::Run(format!("the report cannot be made: {e}")))?;
        crate::command::write(&out.join("report.html"), &html)?;
    }
    Ok(whole)
}

/// How the bench ended, for the report.
fn outcome(whole: &Whole, runs: &[Summarised]) -> Outcome {
    let named = |run: &Summarised, text: &str| {
        if runs.len() > 1 { format!("{}: {text}", run.name) } else { text.to_string() }
    };
    let problems = runs.iter().flat_map(|run| {
        let ending = match &run.ending {
            Ending::Complete => Vec::new(),
            Ending::Interrupted(signal) => vec![format!("ended early by signal {signal}")],
            Ending::Failed(failure) => std::iter::once(format!("{} {}", failure.node, failure.how))
                .chain(failure.last_words.iter().map(|line| format!("{} said: {line}", failure.node)))
                .collect(),
        };
        let broken = run.expect.iter().filter_map(|v| v.why.clone());
        let all = ending.into_iter().chain(broken).chain(run.problems.iter().cloned());
        all.map(|text| named(run, &text)).collect::<Vec<_>>()
    });
    let expected = runs.iter().flat_map(|run| {
        run.expect.iter().map(|v| Expected {
            run: run.name.clone(),
            key: v.key.clone(),
            limit: v.limit,
            found: v.found,
            unit: v.unit.clone(),
            holds: v.holds,
        })
    });
    Outcome {
        verdict: whole.verdict.clone(),
        ok: Some(whole.ok),
        problems: problems.collect(),
        expected: expected.collect(),
    }
}

fn whole(jobs: &Jobs, runs: &[Summarised]) -> Whole {
    let sum = |f: fn(&Summarised) -> u64| runs.iter().map(f).sum();
    Whole {
        schema: SUMMARY_SCHEMA,
        bench: jobs.name.clone(),
        description: jobs.description.clone(),
        version: env!("CARGO_PKG_VERSION"),
        verdict: super::verdict::sentence(runs),
        ok: runs.len() == jobs.runs.len() && runs.iter().all(|r| r.ending == Ending::Complete && r.holds()),
        timing: Totals {
            steps: sum(|r| r.steps),
            wall_s: runs.iter().map(|r| r.wall_s).sum(),
            deadline_misses: sum(|r| r.timing.deadline_misses),
            held_steps: sum(|r| r.timing.held_steps),
            failsafe_steps: sum(|r| r.timing.failsafe_steps),
            lost: sum(|r| r.timing.lost),
            restarts: sum(|r| r.timing.restarts),
        },
        runs: runs.iter().map(of_run).collect(),
    }
}

fn of_run(run: &Summarised) -> OfRun {
    let (how, signal, failure) = match &run.ending {
        Ending::Complete => ("complete", None, None),
        Ending::Interrupted(signal) => ("interrupted", Some(*signal), None),
        Ending::Failed(failure) => ("failed", None, Some(failure)),
    };
    let mut figures = run.figures.clone();
    if let Some(figures) = &mut figures {
        figures.timing = run.timing.clone();
    }
    OfRun {
        variant: run.variant.clone(),
        ended: Ended {
            how,
            signal,
            node: failure.map(|f| f.node.clone()),
            why: failure.map(|f| f.how.clone()),
            last_words: failure.map(|f| f.last_words.clone()).unwrap_or_default(),
            restarts: run.restarts.iter().cloned().collect(),
        },
        rate_hz: 1e9 / run.plan.config.period_ns as f64,
        law: serde_json::to_value(run.plan.config.controller.law).unwrap_or_default(),
        steps: run.steps,
        wall_s: run.wall_s,
        steps_per_s: run.steps as f64 / run.wall_s.max(1e-9),
        expect: run.expect.clone(),
        problems: run.problems.clone(),
        reported: figures.is_none().then(|| run.timing.clone()),
        figures,
    }
}
