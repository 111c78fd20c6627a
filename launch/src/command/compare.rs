//! `whirlstand compare`: a record compared with the simulation, or runs with each other.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use whirlstand_diagnose::screen;
use whirlstand_evaluate::{Run, RunSummary};
use whirlstand_ident::CompareOptions;
use whirlstand_logs::Record;
use whirlstand_report::Outcome;
use whirlstand_vehicle::Vehicle;

use super::vehicles::find;
use super::{print, tell, write, write_json};
use crate::cli::CompareArgs;
use crate::error::Failure;

/// Runs the command.
pub(crate) fn compare(args: &CompareArgs) -> Result<ExitCode, Failure> {
    match (args.logs.as_slice(), &args.vehicle) {
        ([log], Some(vehicle)) => with_simulation(args, log, vehicle),
        ([_], None) => Err(Failure::Mend(
            "name the vehicle that the record is compared with (--vehicle V), or a second run: \
             whirlstand compare LOG LOG"
                .into(),
        )),
        (_, Some(_)) => Err(Failure::Mend(
            "--vehicle compares one record with the simulation, but several are given: omit it to compare runs \
             with each other"
                .into(),
        )),
        (logs, None) => runs(logs, args),
    }
}

fn with_simulation(args: &CompareArgs, log: &Path, vehicle: &str) -> Result<ExitCode, Failure> {
    let vehicle = find(vehicle)?;
    let options = options(args)?;
    let record = super::log::read_for(log, &args.part.map, &vehicle)?;
    let mut comparison = whirlstand_ident::compare(&record, &vehicle, &options).map_err(Failure::mend)?;
    if let Some(wrong) = wrong_data(record, &vehicle, &options) {
        comparison.verdict = format!("Inconclusive: {wrong}. {}", comparison.verdict);
        comparison.remarks.insert(0, wrong);
    }
    if let Some(path) = &args.result.json.path {
        write_json(&comparison, path)?;
    }
    let report = args.result.out.as_ref().map(|folder| folder.join("report.html"));
    if let Some(path) = &report {
        let html = whirlstand_report::comparison_report(&comparison).map_err(Failure::run)?;
        write(path, &html)?;
    }
    if !args.result.json.is_printed() {
        let mut text = comparison.text();
        if let Some(path) = &report {
            text.push_str(&format!("report  {}\n", path.display()));
        }
        print(&text)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A message when columns are in a wrong unit or the record is of another vehicle; `None` also when this cannot
/// be checked.
fn wrong_data(record: Record, vehicle: &Vehicle, options: &CompareOptions) -> Option<String> {
    let (from, until) = (options.from_s, options.until_s);
    let part = record.between(from.unwrap_or(f64::NEG_INFINITY), until.unwrap_or(f64::INFINITY));
    let part = match options.period_s {
        Some(period_s) if part.time_unit == "samples" => [part.with_sample_period(period_s)],
        _ => [part],
    };
    let units = screen::wrong_units(&part, vehicle, options.period_s).ok()?;
    if !units.is_empty() {
        return Some(units.into_iter().map(|f| f.text).collect::<Vec<_>>().join("; "));
    }
    screen::stranger(&part, vehicle, &[], options.period_s).ok().flatten().map(|f| f.text)
}

fn options(args: &CompareArgs) -> Result<CompareOptions, Failure> {
    for (name, value) in [("--period", args.part.period), ("--horizon", Some(args.horizon))] {
        if value.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
            return Err(Failure::Mend(format!("{name}: a time above 0 s is expected")));
        }
    }
    if let (Some(from), Some(until)) = (args.part.from, args.part.to)
        && from >= until
    {
        return Err(Failure::Mend(format!(
            "--from {from} is after --to {until}: nothing is left to compare"
        )));
    }
    Ok(CompareOptions {
        period_s: args.part.period,
        from_s: args.part.from,
        until_s: args.part.to,
        horizon_s: args.horizon,
    })
}

/// Compares several runs side by side, as the variants of a launch file are.
fn runs(logs: &[PathBuf], args: &CompareArgs) -> Result<ExitCode, Failure> {
    let names = names(logs);
    let runs = logs
        .iter()
        .zip(&names)
        .map(|(log, name)| Run::open(log, name, None).map_err(Failure::mend))
        .collect::<Result<Vec<_>, _>>()?;
    let vehicles: BTreeSet<&str> = runs.iter().map(|run| run.vehicle.name.as_str()).collect();
    if vehicles.len() > 1 {
        let all: Vec<_> = vehicles.into_iter().collect();
        return Err(Failure::Mend(format!(
            "the runs are of different vehicles ({}), whose signals cannot be compared",
            all.join(", ")
        )));
    }
    let figures: Vec<RunSummary> = runs.iter().map(|run| run.figures.clone()).collect();
    let verdict = whirlstand_report::winner(&figures, &[])
        .unwrap_or_else(|| "No figure distinguishes these runs.".into());
    let report = args.result.out.as_ref().map(|folder| folder.join("report.html"));
    if let Some(path) = &report {
        let outcome = Outcome { verdict: format!("{} compared.", names.join(", ")), ..Outcome::default() };
        let all: Vec<&Run> = runs.iter().collect();
        let html = whirlstand_report::run_report(&names.join(" and "), "", &outcome, &all);
        write(path, &html.map_err(Failure::run)?)?;
    }
    let told = || {
        let of_run = |(run, log): (&Run, &PathBuf)| format!("  {:<12} {}\n", run.name, log.display());
        let runs: String = runs.iter().zip(logs).map(of_run).collect();
        let report = report.as_ref().map(|path| format!("report  {}\n", path.display()));
        format!("{verdict}\n{runs}{}", report.unwrap_or_default())
    };
    tell(&args.result.json, &figures, told)?;
    Ok(ExitCode::SUCCESS)
}

/// Names of runs: the first path component, counted from the end, in which all paths differ.
fn names(logs: &[PathBuf]) -> Vec<String> {
    let parts = |log: &PathBuf| -> Vec<String> {
        let parts = log.components().rev().map(|c| c.as_os_str().to_string_lossy().into_owned());
        parts.skip_while(|part| part == "log.mcap").collect()
    };
    let all: Vec<Vec<String>> = logs.iter().map(parts).collect();
    let depth = all.iter().map(Vec::len).min().unwrap_or(0);
    for i in 0..depth {
        let names: Vec<String> =
            all.iter().map(|parts| parts[i].strip_suffix(".mcap").unwrap_or(&parts[i]).into()).collect();
        if names.iter().collect::<BTreeSet<_>>().len() == names.len() {
            return names;
        }
    }
    (1..=logs.len()).map(|i| format!("run {i}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_called_what_their_paths_differ_in() {
        let of = |paths: [&str; 2]| names(&paths.map(PathBuf::from));
        assert_eq!(of(["out/a/log.mcap", "out/b/log.mcap"]), ["a", "b"]);
        assert_eq!(of(["x/one.mcap", "x/two.mcap"]), ["one", "two"]);
        assert_eq!(of(["a/log", "b/log"]), ["a", "b"]);
        assert_eq!(of(["a/log.mcap", "a/log.mcap"]), ["run 1", "run 2"]);
    }
}
