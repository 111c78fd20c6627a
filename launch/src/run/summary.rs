//! Writes the figures of a run: `summary.json` and `report.html`.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use whirlstand_evaluate::CheckedExpectation;
use whirlstand_evaluate::metrics::{Timing, total};
use whirlstand_evaluate::summary::SUMMARY_SCHEMA;
use whirlstand_evaluate::{Run, RunSummary};
use whirlstand_report::{Expected, Outcome};

use super::summarised::Summarised;
use crate::error::Failure;
use crate::file::Jobs;
use crate::supervisor::Ending;

/// The contents of `summary.json`.
#[derive(Debug, Serialize)]
pub(super) struct SummaryFile {
    schema: &'static str,
    bench: String,
    description: String,
    version: &'static str,
    /// The verdict in a sentence.
    verdict: String,
    /// True when every run was complete and every expectation held.
    ok: bool,
    /// Counts over all runs.
    timing: Totals,
    runs: Vec<RunEntry>,
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
struct RunEntry {
    variant: Option<String>,
    ended: EndEntry,
    /// Requested rate of the loop, Hz.
    rate_hz: f64,
    /// The law, or the name of the autopilot that replaces it.
    law: String,
    steps: u64,
    wall_s: f64,
    steps_per_s: f64,
    expect: Vec<CheckedExpectation>,
    /// Whether another run leaves the same log, bit for bit. The reasons against it follow.
    reproducible: bool,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    not_reproducible: Vec<String>,
    problems: Vec<String>,
    /// Figures from the log; null for a run without one.
    #[serde(flatten)]
    figures: Option<RunSummary>,
    /// Timing figures of a run without a log, as its nodes reported them.
    #[serde(skip_serializing_if = "Option::is_none", rename = "timing")]
    reported: Option<Timing>,
}

#[derive(Debug, Serialize)]
struct EndEntry {
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

/// Writes `summary.json` and `report.html` into `out`.
pub(super) fn write(
    jobs: &Jobs,
    out: &Path,
    whole: &SummaryFile,
    runs: &[Summarised],
) -> Result<(), Failure> {
    crate::command::write_json(whole, &out.join("summary.json"))?;
    let recorded: Vec<&Run> = runs.iter().filter_map(|r| r.recorded.as_ref()).collect();
    // A failure before anything was recorded is reported as well.
    if !recorded.is_empty() || !whole.ok {
        let outcome = Outcome { files: files(out, runs), ..outcome(whole, runs) };
        let html = whirlstand_report::run_report(&jobs.name, &jobs.description, &outcome, &recorded)
            .map_err(|e| Failure::Run(format!("the report cannot be made: {e}")))?;
        crate::command::write(&out.join("report.html"), &html)?;
    }
    Ok(())
}

/// Paths of log and summary relative to `out`, where the report is.
fn files(out: &Path, runs: &[Summarised]) -> Vec<(String, String)> {
    let logs = runs.iter().filter_map(|run| run.log.as_ref()?.strip_prefix(out).ok());
    let logs = logs.map(|path| path.display().to_string());
    logs.chain(["summary.json".to_string()]).map(|path| (path.clone(), path)).collect()
}

/// How the bench ended, for the report.
fn outcome(whole: &SummaryFile, runs: &[Summarised]) -> Outcome {
    let named = |run: &Summarised, text: &str| {
        if runs.len() > 1 { format!("{}: {text}", run.name) } else { text.to_string() }
    };
    let problems = runs.iter().flat_map(|run| {
        let ending = match &run.ending {
            Ending::Complete => Vec::new(),
            Ending::Interrupted(signal) => vec![format!("ended early by signal {signal}")],
            Ending::Failed(failure) => std::iter::once(format!("{} {}", failure.node, failure.how))
                .chain(failure.last_lines.iter().map(|line| format!("{} said: {line}", failure.node)))
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
        files: Vec::new(),
    }
}

/// The contents of `summary.json` for these runs.
pub(super) fn whole(jobs: &Jobs, runs: &[Summarised]) -> SummaryFile {
    let sum = |f: fn(&Summarised) -> u64| total(runs.iter().map(f));
    SummaryFile {
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

fn of_run(run: &Summarised) -> RunEntry {
    let (how, signal, failure) = match &run.ending {
        Ending::Complete => ("complete", None, None),
        Ending::Interrupted(signal) => ("interrupted", Some(*signal), None),
        Ending::Failed(failure) => ("failed", None, Some(failure)),
    };
    let mut figures = run.figures.clone();
    if let Some(figures) = &mut figures {
        figures.timing = run.timing.clone();
    }
    RunEntry {
        variant: run.variant.clone(),
        ended: EndEntry {
            how,
            signal,
            node: failure.map(|f| f.node.clone()),
            why: failure.map(|f| f.how.clone()),
            last_words: failure.map(|f| f.last_lines.clone()).unwrap_or_default(),
            restarts: run.restarts.iter().cloned().collect(),
        },
        rate_hz: 1e9 / run.plan.config.period_ns as f64,
        law: super::law::law(&run.plan.config),
        steps: run.steps,
        wall_s: run.wall_s,
        steps_per_s: run.steps as f64 / run.wall_s.max(1e-9),
        expect: run.expect.clone(),
        reproducible: run.not_reproducible.is_empty(),
        not_reproducible: run.not_reproducible.clone(),
        problems: run.problems.clone(),
        reported: figures.is_none().then(|| run.timing.clone()),
        figures,
    }
}
