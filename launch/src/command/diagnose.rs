//! `whirlstand diagnose`: the verdict, the causes, the extended vehicle, and the gain in accuracy.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use whirlstand_diagnose::{Diagnosis, Options, Watch, diagnose as run};
use whirlstand_logs::Record;
use whirlstand_vehicle::Vehicle;

use super::early_end::EarlyEnd;
use super::log::{check_delays, period_of, read_for};
use super::vehicles::find;
use super::{print, write, write_json};
use crate::cli::{DiagnoseArgs, RecordArgs};
use crate::error::Failure;

/// Runs the command. SIGINT and SIGTERM end the search; the results found by then are reported, with exit code
/// 130. A second signal ends the program. A budget of time ends the search in the same way, with exit code 3.
pub(crate) fn diagnose(args: &DiagnoseArgs) -> Result<ExitCode, Failure> {
    crate::memory::give_large_pieces_back();
    let vehicle = find(&args.vehicle)?;
    let (search, watch) = EarlyEnd::new("diagnose", args.budget)?;
    let mut options = options(args, &vehicle, watch)?;
    let records =
        args.logs.iter().map(|path| part(path, &args.part, &vehicle)).collect::<Result<Vec<_>, _>>()?;
    options.period_s = records.first().and_then(|record| period_of(&args.part, &vehicle, record));
    let answer = run(records, &vehicle, &options);
    let search = search.finish();
    let mut answer = answer.map_err(Failure::mend)?;
    let extended =
        args.output.clone().or_else(|| args.result.out.as_ref().map(|folder| folder.join("vehicle.toml")));
    if let (Some(path), Some(vehicle)) = (&extended, &answer.extended) {
        write(path, &vehicle.to_toml())?;
        answer.extended_vehicle = Some(path.display().to_string());
    }
    if let Some(path) = &args.result.json.path {
        write_json(&answer, path)?;
    }
    let report = args.result.out.as_ref().map(|folder| folder.join("report.html"));
    if let Some(path) = &report {
        write(path, &whirlstand_report::diagnosis_report(&answer).map_err(Failure::run)?)?;
    }
    if !args.result.json.is_printed() {
        print(&text(&answer, report.as_deref()))?;
    }
    Ok(search.exit_code(answer.partial))
}

fn text(answer: &Diagnosis, report: Option<&Path>) -> String {
    let mut text = answer.text();
    let vehicle = answer.extended_vehicle.as_ref().map(|v| format!("vehicle {v}"));
    let report = report.map(|path| format!("report {}", path.display()));
    let files: Vec<String> = [vehicle, report].into_iter().flatten().collect();
    if !files.is_empty() {
        text.push_str(&format!("{}\n", files.join("   ")));
    }
    text
}

/// Checks the requested part of a record.
pub(crate) fn check_part(part: &RecordArgs) -> Result<(), Failure> {
    if part.period.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
        return Err(Failure::Mend("--period: a time above 0 s is expected".into()));
    }
    if let (Some(from), Some(to)) = (part.from, part.to)
        && from >= to
    {
        return Err(Failure::Mend(format!("--from {from} is after --to {to}: nothing is left to diagnose")));
    }
    Ok(())
}

fn options(args: &DiagnoseArgs, vehicle: &Vehicle, watch: Watch) -> Result<Options, Failure> {
    check_part(&args.part)?;
    if args.horizon.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
        return Err(Failure::Mend("--horizon: a time above 0 s is expected".into()));
    }
    let ground =
        |path: &Option<PathBuf>| path.as_ref().map(|p| read_for(p, &args.part.map, vehicle)).transpose();
    Ok(Options {
        period_s: None,
        horizon_s: args.horizon,
        refit: args.refit.then_some(true),
        modes: args.mode.clone(),
        engine_on: ground(&args.engine_on)?,
        engine_off: ground(&args.engine_off)?,
        watch,
    })
}

/// Reads a log, resamples it to the requested clock, and cuts out the requested part.
pub(crate) fn part(path: &Path, part: &RecordArgs, vehicle: &Vehicle) -> Result<Record, Failure> {
    let mut record = read_for(path, &part.map, vehicle)?;
    if let Some(period) = part.period
        && record.time_unit == "samples"
    {
        record = record.with_sample_period(period);
    }
    if part.from.is_some() || part.to.is_some() {
        record = record.between(part.from.unwrap_or(f64::NEG_INFINITY), part.to.unwrap_or(f64::INFINITY));
        check_delays(vehicle, &record)?;
    }
    Ok(record)
}
