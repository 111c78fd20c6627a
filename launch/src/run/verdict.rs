//! Texts on the result of a run: a few lines at its end, and one sentence for the report.

use std::collections::BTreeMap;
use std::path::Path;

use whirlstand_evaluate::RunSummary;
use whirlstand_evaluate::expectation::CheckedExpectation;
use whirlstand_evaluate::summary::FindingEvent;
use whirlstand_nodes::config::Mode;

use super::summarised::Summarised;
use crate::style;
use crate::supervisor::Ending;

/// Most outputs in the verdict: those that moved most, in the order of their names.
const MOST_OUTPUTS: usize = 4;

/// The lines that are printed at the end of a run.
pub(super) fn closing_lines(out: &Path, runs: &[Summarised]) -> String {
    let mut text = String::new();
    for run in runs {
        text.push_str(&of_run(run));
    }
    let mut file = |head: &str, name: &str| {
        let path = out.join(name);
        if path.is_file() {
            text.push_str(&format!("  {:<12}{}\n", head, from_here(&path)));
        }
    };
    file("summary", "summary.json");
    file("report", "report.html");
    text
}

/// A path as the user can type it: relative to the current folder where it is inside that.
fn from_here(path: &Path) -> String {
    let here = std::env::current_dir().and_then(|here| here.canonicalize());
    let below = here.ok().and_then(|here| path.strip_prefix(here).ok().map(Path::to_path_buf));
    below.as_deref().unwrap_or(path).display().to_string()
}

fn of_run(run: &Summarised) -> String {
    let verdict = match &run.ending {
        Ending::Complete if run.holds() => style::good("completed"),
        Ending::Complete => style::bad("completed, but not as expected"),
        Ending::Interrupted(signal) => {
            let name = signal_hook::low_level::signal_name(*signal).unwrap_or("a signal");
            style::bad(&format!("ended early by {name}"))
        }
        Ending::Failed(failure) => style::bad(&format!("failed: {} {}", failure.node, failure.how)),
    };
    let mut text = format!("{} {verdict}\n", style::strong(&run.name));
    let mut row = |head: &str, body: String| text.push_str(&format!("  {head:<12}{body}\n"));
    if let Ending::Failed(failure) = &run.ending {
        for line in &failure.last_lines {
            row("", style::dim(line));
        }
    }
    if let Some(figures) = &run.figures {
        for (i, event) in figures.disturbances.iter().enumerate() {
            let head = if i == 0 { "disturbance" } else { "" };
            row(
                head,
                format!("at {:.2} s on {}: {}", event.at_s, event.place, response(figures, event.at_s)),
            );
        }
    }
    for (i, found) in run.figures.iter().flat_map(last_words).enumerate() {
        let head = if i == 0 { "mirror" } else { "" };
        row(head, style::bad(&format!("at {:.2} s: {}", found.at_s, found.text)));
    }
    row("timing", timing(run));
    let mut restarts: Vec<_> = run.restarts.iter().map(|(node, n)| format!("{node} {n}")).collect();
    restarts.sort();
    if !restarts.is_empty() {
        row("restarts", restarts.join(", "));
    }
    if run.timing.failsafe_steps > 0 {
        row("failsafe", style::bad(&format!("{} steps", run.timing.failsafe_steps)));
    }
    for (share, what) in [(run.timing.disarmed_share, "disarmed"), (run.timing.pilot_share, "pilot")] {
        if let Some(share) = share.filter(|share| *share > 0.0) {
            row(what, style::bad(&format!("{:.1} % of the flight", 100.0 * share)));
        }
    }
    if !run.expect.is_empty() {
        let holding = run.expect.iter().filter(|v| v.holds).count();
        row("expected", format!("{holding} of {} met", run.expect.len()));
        for broken in broken(run) {
            row("", style::bad(broken.why.as_deref().unwrap_or_default()));
        }
    }
    if run.plan.config.mode == Mode::Lockstep && !run.not_reproducible.is_empty() {
        let why = run.not_reproducible.join("; ");
        row("bit for bit", style::bad(&format!("another run may differ: {why}")));
    }
    for problem in &run.problems {
        row("problem", style::bad(problem));
    }
    if let Some(log) = &run.log {
        row("log", from_here(log));
    }
    text
}

/// The expectations that do not hold, in the order of their names.
fn broken(run: &Summarised) -> Vec<&CheckedExpectation> {
    let mut broken: Vec<_> = run.expect.iter().filter(|v| !v.holds).collect();
    broken.sort_by_key(|v| v.key.as_str());
    broken
}

/// The last finding of the mirror on each change.
fn last_words(figures: &RunSummary) -> Vec<&FindingEvent> {
    let mut last: BTreeMap<u64, &FindingEvent> = BTreeMap::new();
    last.extend(figures.findings.iter().map(|found| (found.number, found)));
    last.into_values().collect()
}

/// Text on the outputs that a disturbance moved most, relative to their recovery band: peak and recovery
/// time.
fn response(figures: &RunSummary, at_s: f64) -> String {
    let mut moved: Vec<_> = figures
        .outputs
        .iter()
        .filter(|(name, _)| !name.ends_with("_rate"))
        .filter_map(|(name, o)| Some((name, o, o.disturbances.iter().find(|d| d.at_s == at_s)?)))
        .filter(|(_, _, d)| d.peak > d.band)
        .collect();
    // Most bands are the same share of their peak, so rounding must not decide the order.
    moved.sort_by_key(|(_, _, d)| std::cmp::Reverse((1e3 * d.peak / d.band.max(1e-12)).round() as u64));
    if moved.is_empty() {
        return "nothing measurable".into();
    }
    moved.truncate(MOST_OUTPUTS);
    moved.sort_by_key(|(name, _, _)| name.as_str());
    let texts = moved.iter().map(|(name, o, d)| match d.recovery_s {
        Some(back) => format!("{name} by {}, recovered in {back:.2} s", o.unit.text(d.peak)),
        None => format!("{name} by {}, not recovered", o.unit.text(d.peak)),
    });
    texts.collect::<Vec<_>>().join("; ")
}

fn timing(run: &Summarised) -> String {
    let mut text = format!(
        "{} steps in {:.2} s, deadline misses {}, lost {}",
        run.steps, run.wall_s, run.timing.deadline_misses, run.timing.lost
    );
    if let Some(l) = run.timing.nodes.get("plant").and_then(|p| p.latency) {
        text.push_str(&format!(
            "; command latency p50 {:.0} us, p99 {:.0} us, max {:.0} us",
            l.p50_us, l.p99_us, l.max_us
        ));
    }
    text
}

/// The verdict over all runs in a sentence.
pub(super) fn sentence(runs: &[Summarised]) -> String {
    let of_run = |run: &Summarised| {
        let end = match &run.ending {
            Ending::Complete if run.holds() => "completed".to_string(),
            Ending::Complete => {
                let broken = broken(run).into_iter().map(|v| v.key.as_str());
                let all: Vec<_> = broken.chain(run.problems.iter().map(String::as_str)).collect();
                format!("completed, but not as expected ({})", all.join(", "))
            }
            Ending::Interrupted(_) => "was ended early".to_string(),
            Ending::Failed(failure) => format!("failed: {} {}", failure.node, failure.how),
        };
        let gust = run.figures.as_ref().and_then(|f| {
            let event = f.disturbances.first()?;
            Some(format!("; the disturbance at {:.1} s moved {}", event.at_s, response(f, event.at_s)))
        });
        let found = run.figures.iter().flat_map(last_words);
        let mirror: String = found.map(|found| format!("; mirror: {}", found.text)).collect();
        format!("{} {end}{}{mirror}", run.name, gust.unwrap_or_default())
    };
    runs.iter().map(of_run).collect::<Vec<_>>().join(". ") + "."
}
