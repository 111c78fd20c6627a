//! `whirlstand compare`: a record compared with the simulation.

use std::process::ExitCode;

use whirlstand_ident::CompareOptions;

use super::vehicles::find;
use super::{print, write, write_json};
use crate::cli::CompareArgs;
use crate::error::Failure;

/// Runs the command.
pub(crate) fn compare(args: &CompareArgs) -> Result<ExitCode, Failure> {
    let vehicle = find(&args.vehicle)?;
    let options = options(args)?;
    let record = super::log::read_for(&args.log, &args.part.map, &vehicle)?;
    let comparison = whirlstand_ident::compare(&record, &vehicle, &options).map_err(Failure::mend)?;
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
            "--from {from} lies behind --to {until}: nothing is left to compare"
        )));
    }
    Ok(CompareOptions {
        period_s: args.part.period,
        from_s: args.part.from,
        until_s: args.part.to,
        horizon_s: args.horizon,
    })
}
