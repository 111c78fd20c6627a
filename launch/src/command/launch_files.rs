//! `whirlstand launch list|show`.

use std::process::ExitCode;

use serde::Serialize;

use super::tell;
use crate::cli::{JsonArg, LaunchCommand, OverrideArgs};
use crate::error::Failure;
use crate::file::{BUILTIN, DEFAULT, find, jobs};
use crate::style;

#[derive(Debug, Serialize)]
struct Listed {
    name: &'static str,
    vehicle: String,
    description: String,
    runs: Vec<String>,
    default: bool,
}

/// Runs the command.
pub(crate) fn launch_files(command: &LaunchCommand) -> Result<ExitCode, Failure> {
    match command {
        LaunchCommand::List { json } => list(json)?,
        LaunchCommand::Show { launch } => super::print_data(find(launch)?.document.text())?,
    }
    Ok(ExitCode::SUCCESS)
}

fn list(json: &JsonArg) -> Result<(), Failure> {
    let mut all = Vec::new();
    for (name, _) in BUILTIN {
        let jobs = jobs(name, &OverrideArgs::default(), false)?;
        all.push(Listed {
            name,
            vehicle: jobs.runs.first().map(|job| job.plan.vehicle.name.clone()).unwrap_or_default(),
            description: jobs.description,
            runs: jobs.runs.iter().filter_map(|job| job.variant.clone()).collect(),
            default: *name == DEFAULT,
        });
    }
    let value = serde_json::json!({ "schema": "whirlstand.launch_files.v1", "launch_files": all });
    tell(json, &value, || list_text(&all))
}

fn list_text(all: &[Listed]) -> String {
    let mut text = String::new();
    for l in all {
        text.push_str(&format!("{}  {}\n", style::strong(&format!("{:<28}", l.name)), l.description));
    }
    text.push_str(&style::dim(
        "\n`whirlstand run NAME` flies one, `whirlstand launch show NAME > mine.toml` gives a file to start from.\n",
    ));
    text
}
