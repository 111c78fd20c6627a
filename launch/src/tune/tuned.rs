//! The launch files that a tuning writes.

use std::path::Path;

use toml::{Table, Value};
use whirlstand_nodes::config::ControllerConfig;

use super::draws::is_disturbance;
use super::judge::Gain;
use crate::error::Failure;
use crate::file::FoundFile;

/// Name of the extended vehicle file beside the launch file.
pub(super) const MODEL: &str = "vehicle.toml";

/// Name of the vehicle file of the worst draw.
pub(super) const WORST_VEHICLE: &str = "worst-vehicle.toml";

/// The law that a tuning chose.
pub(super) struct Choice<'a> {
    /// Whether the extended vehicle differs from the one before.
    pub has_model: bool,
    /// The new law with its options.
    pub controller: &'a ControllerConfig,
    /// Whether the options were chosen anew, so that they have to be written.
    pub is_retuned: bool,
    /// Comparison of the laws, including whether the new one is kept.
    pub gain: &'a Gain,
}

/// The original launch file, with the new law where it is kept, and with absolute paths.
pub(super) fn launch_file(found: &FoundFile, choice: &Choice<'_>) -> Result<String, Failure> {
    let table = chosen(found, choice)?;
    let head = if choice.gain.certain { "the new law is kept" } else { "the old law is kept" };
    let text = toml::to_string(&table).map_err(Failure::run)?;
    Ok(format!("# Written by whirlstand tune; {head}: {}.\n{text}", choice.gain.why))
}

/// The launch file of one draw under the kept law, with its vehicle, its seed and the disturbances.
pub(super) fn draw_file(
    found: &FoundFile,
    choice: &Choice<'_>,
    seed: u64,
    effects: &[whirlstand_vehicle::Effect],
) -> Result<String, Failure> {
    let mut table = chosen(found, choice)?;
    let flown = table.insert("vehicle".into(), Value::String(WORST_VEHICLE.into()));
    if let (false, Some(flown)) = (table.contains_key("model"), flown) {
        table.insert("model".into(), flown);
    }
    if let Some(Value::Array(own)) = table.get_mut("effects") {
        let mut stays = effects.iter().map(is_disturbance);
        own.retain(|_| stays.next().unwrap_or(false));
    }
    let seed = i64::try_from(seed).map_err(Failure::run)?;
    table.insert("seed".into(), Value::Integer(seed));
    table.insert("mode".into(), Value::String("lockstep".into()));
    toml::to_string(&table).map_err(Failure::run)
}

fn chosen(found: &FoundFile, choice: &Choice<'_>) -> Result<Table, Failure> {
    let mut table: Table = found.document.text().parse().map_err(Failure::run)?;
    if choice.gain.certain && choice.has_model {
        table.insert("model".into(), Value::String(MODEL.into()));
    } else {
        anchor(&mut table, &["model"], &found.folder);
    }
    anchor(&mut table, &["vehicle"], &found.folder);
    anchor(&mut table, &["security", "keys"], &found.folder);
    anchor(&mut table, &["zenoh", "config"], &found.folder);
    if choice.gain.certain
        && let Some(Value::Table(controller)) = table.get_mut("controller")
    {
        let options = Value::try_from(choice.controller).map_err(Failure::run)?;
        let retuned = ["q", "r", "integral_q", "bandwidth", "boundary_layer"];
        let keys = retuned.into_iter().filter(|_| choice.is_retuned).chain(["law"]);
        for key in keys {
            if let Some(value) = options.get(key) {
                controller.insert(key.into(), value.clone());
            }
        }
    }
    if !table.contains_key("name") {
        table.insert("name".into(), Value::String(found.name.clone()));
    }
    Ok(table)
}

/// Rewrites a path relative to the old launch file so that it is valid from the new one.
fn anchor(table: &mut Table, keys: &[&str], folder: &Path) {
    let [rest @ .., last] = keys else { return };
    let mut table = table;
    for key in rest {
        let Some(Value::Table(inner)) = table.get_mut(*key) else { return };
        table = inner;
    }
    let Some(Value::String(text)) = table.get_mut(*last) else { return };
    let path = folder.join(&*text);
    if path.exists()
        && let Ok(absolute) = std::path::absolute(&path)
    {
        *text = absolute.display().to_string();
    }
}
