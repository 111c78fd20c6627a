//! `whirlstand vehicle new`: a first vehicle file from a record.

use std::path::Path;

use whirlstand_ident::draft::{Choice, Names, draft};
use whirlstand_ident::watch::Stage;

use super::log::hash;
use super::stage_line::StageLine;
use super::{print, write, write_json};
use crate::cli::VehicleNewArgs;
use crate::error::Failure;

/// Runs the command.
pub(crate) fn vehicle_new(args: &VehicleNewArgs) -> Result<(), Failure> {
    if let (Some(from), Some(to)) = (args.from, args.to)
        && from >= to
    {
        return Err(Failure::Mend(format!(
            "--from {from} is after --to {to}: nothing is left to draft from"
        )));
    }
    let stem = args.output.as_deref().and_then(Path::file_stem);
    let names = Names {
        choice: Choice { inputs: args.input.clone(), outputs: args.measure.clone() },
        time: args.time.clone(),
        period_s: args.period,
        vehicle: stem.map(|stem| stem.to_string_lossy().into_owned()),
        sha256: args.logs.iter().map(|log| hash(log)).collect::<Result<_, _>>()?,
    };
    let line = StageLine::new("vehicle new", None);
    let listener = line.listener();
    let answer = draft(&args.logs, &names, (args.from, args.to), &|what: &str| {
        listener(Stage { what, detail: "", share: None });
    });
    line.finish();
    let mut answer = answer.map_err(Failure::mend)?;
    if let Some(path) = &args.output {
        write(path, &answer.toml)?;
        answer.vehicle_file = Some(path.display().to_string());
    }
    if let Some(path) = &args.json.path {
        write_json(&answer, path)?;
    }
    if !args.json.is_printed() {
        print(&answer.text())?;
        if args.output.is_none() {
            print(&format!("\n{}", answer.toml))?;
        }
    }
    Ok(())
}
