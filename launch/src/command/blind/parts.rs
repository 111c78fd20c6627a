//! A run in parts: the results that each part writes, and how the parts are joined.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use whirlstand_blind::{Setting, Tally};
use whirlstand_campaign::{PartsError, Shard};

use crate::error::Failure;

/// The results of a run, or of a part of one.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Results {
    #[serde(flatten)]
    pub tally: Tally,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub part: Option<Part>,
}

/// Identifies a part of a run, including the data that the call does not state.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Part {
    shard: Shard,
    version: String,
    /// Digest of the vehicle and the record that are flown.
    digest: String,
}

impl Part {
    /// The part `shard` of trials in this setting, run by this program.
    pub fn new(shard: Shard, setting: &Setting) -> Self {
        let mut digest = Sha256::new();
        if let Some(vehicle) = &setting.vehicle {
            digest.update(vehicle.to_toml());
        }
        if let Some(commands) = &setting.commands {
            let numbers = commands.inputs.iter().flatten().chain([&commands.period_s]);
            numbers.for_each(|number| digest.update(number.to_le_bytes()));
        }
        let digest = digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
        Self { shard, version: env!("CARGO_PKG_VERSION").into(), digest }
    }
}

impl Results {
    /// Reads the results that `--json` wrote.
    ///
    /// # Errors
    /// A sentence on why they cannot be read.
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = std::fs::read_to_string(path).map_err(|e| e.to_string())?;
        serde_json::from_str(&text)
            .map_err(|e| format!("not the results of whirlstand blind (its --json): {e}"))
    }
}

/// The call in a tally, without the mark that the run was interrupted.
pub(super) fn of_call(tally: &Tally) -> &str {
    tally.call.split(" (").next().unwrap_or_default()
}

/// The tally of the whole run, joined from the parts in these files.
///
/// # Errors
/// When a part is missing, duplicate, unfinished, or of another run.
pub(super) fn joined(paths: &[PathBuf]) -> Result<Tally, Failure> {
    let parts = paths
        .iter()
        .map(|path| {
            let shown = path.display().to_string();
            let results = Results::read(path).map_err(|why| Failure::Mend(format!("{shown}: {why}")))?;
            Ok((shown, results))
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let shard = |results: &Results| results.part.as_ref().map(|part| part.shard);
    let names: Vec<_> = parts.iter().map(|(shown, results)| (shown.as_str(), shard(results))).collect();
    Shard::check_whole(&names).map_err(Failure::mend)?;
    let (_, first) = parts.first().ok_or_else(|| Failure::mend(PartsError::None))?;
    let (call, of) = (of_call(&first.tally).to_string(), first.part.clone());
    let (mut trials, mut skipped) = (Vec::new(), 0);
    for (path, results) in parts {
        if of_call(&results.tally) != results.tally.call {
            return Err(Failure::Mend(format!(
                "{path} was interrupted: repeat its call with --resume {path}"
            )));
        }
        let of_part = |what: fn(&Part) -> &str| results.part.as_ref().map(what) != of.as_ref().map(what);
        let differs = [
            ("the call", of_call(&results.tally) != call),
            ("the version of the program", of_part(|part| &part.version)),
            ("the vehicle or the record", of_part(|part| &part.digest)),
        ];
        if let Some((what, _)) = differs.into_iter().find(|(_, differs)| *differs) {
            return Err(Failure::mend(PartsError::Mixed { path, what }));
        }
        trials.extend(results.tally.trials);
        skipped += results.tally.skipped;
    }
    Ok(Tally::new(call, trials, skipped))
}
