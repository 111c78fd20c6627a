//! `whirlstand diagnose`: what is wrong, why, the extended vehicle, and the gain.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use whirlstand_ident::diagnose::{Diagnosis, Options, diagnose as run};
use whirlstand_logs::Record;

use super::vehicles::find;
use super::{print, write, write_json};
use crate::cli::DiagnoseArgs;
use crate::error::Failure;

/// Runs the command.
pub(crate) fn diagnose(args: &DiagnoseArgs) -> Result<ExitCode, Failure> {
    let vehicle = find(&args.vehicle)?;
    let options = options(args)?;
    let records = args.logs.iter().map(|path| part(path, args)).collect::<Result<Vec<_>, _>>()?;
    let mut answer = run(&records, &vehicle, &options).map_err(Failure::mend)?;
    let extended =
        args.output.clone().or_else(|| args.result.out.as_ref().map(|folder| folder.join("vehicle.toml")));
    if let (Some(path), Some(vehicle)) = (&extended, &answer.extended) {
        write(path, &vehicle.to_toml())?;
        answer.extended_vehicle = Some(path.display().to_string());
    }
    if let Some(path) = &args.result.json {
        write_json(&answer, path)?;
    }
    let report = args.result.out.as_ref().map(|folder| folder.join("report.html"));
    if let Some(path) = &report {
        write(path, &whirlstand_ident::report::diagnosis_report(&answer).map_err(Failure::run)?)?;
    }
    if args.result.json.as_deref() != Some(Path::new("-")) {
        print(&text(&answer, report.as_deref()))?;
    }
    Ok(ExitCode::SUCCESS)
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

fn options(args: &DiagnoseArgs) -> Result<Options, Failure> {
    if args.part.period.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
        return Err(Failure::Mend("--period: a time above 0 s is expected".into()));
    }
    if let (Some(from), Some(to)) = (args.part.from, args.part.to)
        && from >= to
    {
        return Err(Failure::Mend(format!(
            "--from {from} lies behind --to {to}: nothing is left to diagnose"
        )));
    }
    let ground =
        |path: &Option<PathBuf>| path.as_ref().map(|p| super::log::read(p, &args.part.map)).transpose();
    Ok(Options {
        period_s: args.part.period,
        refit: args.refit.then_some(true),
        modes: args.mode.clone(),
        engine_on: ground(&args.engine_on)?,
        engine_off: ground(&args.engine_off)?,
    })
}

/// Reads a log, on the wanted clock, and takes the wanted part of it.
fn part(path: &Path, args: &DiagnoseArgs) -> Result<Record, Failure> {
    let mut record = super::log::read(path, &args.part.map)?;
    if let Some(period) = args.part.period
        && record.time_unit == "samples"
    {
        record = record.with_sample_period(period);
    }
    if args.part.from.is_some() || args.part.to.is_some() {
        record = record
            .between(args.part.from.unwrap_or(f64::NEG_INFINITY), args.part.to.unwrap_or(f64::INFINITY));
    }
    Ok(record)
}
