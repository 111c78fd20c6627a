//! `whirlstand clean`: finds and removes the files that killed runs left on this machine.

use std::process::ExitCode;

use serde::Serialize;

use super::tell;
use crate::cli::CleanArgs;
use crate::error::Failure;
use crate::exclusive::{StaleRun, remove, stale};
use crate::style;

/// The files that were found, and what was removed.
#[derive(Debug, Serialize)]
struct Cleaned {
    schema: &'static str,
    /// Whether this is a dry run, in which nothing is removed.
    dry_run: bool,
    benches: Vec<Bench>,
    /// Number of files of all benches.
    files: usize,
    /// Memory and disk of all benches, bytes.
    bytes: u64,
}

/// The files of one bench, and whether they were removed.
#[derive(Debug, Serialize)]
struct Bench {
    #[serde(flatten)]
    left: StaleRun,
    removed: bool,
    /// Reason why the files could not be removed.
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

/// Runs the command.
pub(crate) fn clean(args: &CleanArgs) -> Result<ExitCode, Failure> {
    let tidy = |left: StaleRun| {
        let (removed, problem) = match if args.dry_run { Ok(false) } else { remove(&left.bench) } {
            Ok(removed) => (removed, None),
            Err(e) => (false, Some(e.to_string())),
        };
        Bench { left, removed, problem }
    };
    let benches: Vec<_> = stale()?.into_iter().map(tidy).collect();
    let failed = benches.iter().any(|b| b.problem.is_some());
    let cleaned = Cleaned {
        schema: "whirlstand.clean.v1",
        dry_run: args.dry_run,
        files: benches.iter().map(|b| b.left.files).sum(),
        bytes: benches.iter().map(|b| b.left.bytes).sum(),
        benches,
    };
    tell(&args.json, &cleaned, || text(&cleaned))?;
    Ok(if failed { ExitCode::from(1) } else { ExitCode::SUCCESS })
}

/// Removes and reports what killed runs left. A file that cannot be removed does not prevent a flight.
pub(crate) fn tidy(quiet: bool) {
    let left = stale().unwrap_or_else(|e| {
        tracing::warn!("cannot search for what killed runs left behind: {e}");
        Vec::new()
    });
    let mut removed = Vec::new();
    for run in left {
        match remove(&run.bench) {
            Ok(true) => removed.push(run),
            Ok(false) => {}
            Err(e) => tracing::warn!("{e}"),
        }
    }
    if !quiet && !removed.is_empty() {
        let names: Vec<_> = removed.iter().map(|run| run.bench.as_str()).collect();
        let bytes = size(removed.iter().map(|run| run.bytes).sum());
        let text = format!("removed {bytes} left behind by killed runs: {}", names.join(", "));
        style::say(&style::dim(&text));
    }
}

fn text(cleaned: &Cleaned) -> String {
    if cleaned.benches.is_empty() {
        return "killed runs left nothing behind\n".into();
    }
    let mut text = String::new();
    for Bench { left, removed, problem } in &cleaned.benches {
        let done = match (problem, removed) {
            (Some(why), _) => style::bad(why),
            (None, true) => style::good("removed"),
            (None, false) if cleaned.dry_run => style::dim("stale"),
            (None, false) => style::dim("in use again"),
        };
        let (bench, size) = (style::strong(&format!("{:<32}", left.bench)), size(left.bytes));
        text.push_str(&format!("{bench} {:>4} files {size:>10}  since {}  {done}\n", left.files, left.since));
    }
    let (files, size) = (cleaned.files, size(cleaned.bytes));
    text.push_str(&style::dim(&match cleaned.dry_run {
        true => format!("{files} files, {size}: `whirlstand clean` removes them\n"),
        false => format!("{files} files, {size}\n"),
    }));
    text
}

/// An amount of memory as text.
fn size(bytes: u64) -> String {
    match bytes {
        0..0x10_0000 => format!("{:.1} KiB", bytes as f64 / 1024.0),
        _ => format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20)),
    }
}
