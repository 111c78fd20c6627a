//! Runs one cell: flies a record, tunes from it, and flies the laws on the true vehicle.

use std::path::{Path, PathBuf};
use std::time::Instant;

use whirlstand_nodes::error::NodeError;
use whirlstand_nodes::inproc::run_inproc;
use whirlstand_nodes::os::StopFlag;
use whirlstand_vehicle::Vehicle;

use super::answer::{Answer, Cell, OnTruth, Outcome};
use super::cells::{IN_THIS_THREAD, Scene};
use super::processes::Processes;
use crate::cli::{JsonArg, RecordArgs, TuneArgs, TunedLaw};
use crate::command::write;
use crate::error::Failure;
use crate::file::{find, plan};
use crate::tune::{Tuning, circle};

/// Flies a cell; a failure becomes part of the result. `None` when a signal ended it.
pub(super) fn fly(scene: &Scene, draws: u64, processes: Option<Processes>) -> Result<Option<Cell>, Failure> {
    let began = Instant::now();
    let folder = tempfile::Builder::new()
        .prefix("whirlstand-bench-tune-")
        .tempdir()
        .map_err(|e| Failure::Run(format!("cannot create a folder for the flights: {e}")))?;
    let result = match tuned(scene, draws, processes, folder.path()) {
        Ok(None) => return Ok(None),
        Ok(Some(answer)) => answer,
        Err(failure) => Answer::Failed(failure.to_string()),
    };
    let processes = processes.map(|p| p.mode.word().to_owned());
    Ok(Some(Cell { cell: scene.name(), processes, result, wall_s: began.elapsed().as_secs_f64() }))
}

fn tuned(
    scene: &Scene,
    draws: u64,
    processes: Option<Processes>,
    folder: &Path,
) -> Result<Option<Answer>, Failure> {
    let path = |name: &str| folder.join(name);
    let shown = |name: &str| path(name).display().to_string();
    let plain = Vehicle::builtin(scene.vehicle_file()).map_err(Failure::run)?;
    let how = processes.map_or(IN_THIS_THREAD.into(), Processes::words);
    write(&path("launch.toml"), &scene.launch(scene.law, &how))?;
    write(&path("truth.toml"), &(plain.source_text + &scene.hidden_tables()))?;
    let designed = format!("model = 'truth.toml'\n{}", scene.launch(scene.law_afterwards(), &how));
    write(&path("designed.toml"), &designed)?;
    let log = match processes {
        None => record(&shown("launch.toml"), path("log.mcap"))?,
        Some(processes) => match processes.record(&shown("launch.toml"), &path("record"))? {
            Some(log) => log,
            None => return Ok(None),
        },
    };
    let law = match scene.law_afterwards() {
        law if law == scene.law => None,
        _ => Some(TunedLaw::Smc),
    };
    let args = TuneArgs {
        logs: vec![log],
        launch: shown("launch.toml"),
        law,
        draws,
        retune: false,
        max_sensitivity: TuneArgs::MAX_SENSITIVITY,
        part: RecordArgs::default(),
        truth: processes.is_none().then(|| shown("truth.toml")),
        out: path("tuned"),
        json: JsonArg::default(),
    };
    let Some(tuning) = circle(&args)? else { return Ok(None) };
    match processes {
        None => Ok(Some(outcome(&tuning))),
        Some(processes) => processes.outcome(&tuning, named(&tuning), folder),
    }
}

/// Flies a launch file in this thread and writes its log. A flight that ends in divergence gives a record
/// too.
fn record(launch: &str, log: PathBuf) -> Result<PathBuf, Failure> {
    let found = find(launch)?;
    let mut config = plan(&found.document, &found.name, &found.folder).map_err(Failure::mend)?.config;
    config.bench = format!("bench-tune-{}", std::process::id());
    if let Some(recorder) = &mut config.recorder {
        recorder.path = log.display().to_string();
    }
    match run_inproc(&config, &StopFlag::default()) {
        Ok(_) | Err(NodeError::Diverged { .. }) => Ok(log),
        Err(error) => Err(Failure::run(error)),
    }
}

/// Causes that the diagnosis named, as text with their parameters.
fn named(tuning: &Tuning) -> Vec<String> {
    let named = tuning.causes.iter().map(|cause| {
        let values: Vec<String> =
            cause.parameters.iter().map(|(name, e)| format!("{name} {}", rounded(e.value))).collect();
        format!("`{}` {}: {}", cause.effect, cause.place, values.join(", "))
    });
    named.collect()
}

fn outcome(tuning: &Tuning) -> Answer {
    let Some(truth) = &tuning.truth else {
        return Answer::Failed("no law was flown on the true vehicle".into());
    };
    Answer::Flown(Box::new(Outcome {
        named: named(tuning),
        kept: tuning.gain.certain,
        before: OnTruth::of(&truth.before),
        after: OnTruth::of(&truth.after),
        new: OnTruth::of(&truth.new),
        designed: OnTruth::of(&truth.designed),
        share: truth.share,
        after_over_before_low: truth.gain.cost_ratio_low,
        designed_over_before_high: truth.gain_of_designed.cost_ratio_high,
    }))
}

/// The value rounded to three significant digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
