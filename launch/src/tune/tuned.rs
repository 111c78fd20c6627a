//! The launch file that a tuning leaves.

use std::path::Path;

use toml::{Table, Value};
use whirlstand_nodes::config::LawKind;

use super::judge::Gain;
use crate::error::Failure;
use crate::file::FoundFile;

/// Name of the extended vehicle file beside the launch file.
pub(super) const MODEL: &str = "vehicle.toml";

/// The launch file as it was, with the new law where it is kept, and with paths that hold from any folder.
pub(super) fn launch_file(
    found: &FoundFile,
    has_model: bool,
    law: LawKind,
    gain: &Gain,
) -> Result<String, Failure> {
    let mut table: Table = found.document.text().parse().map_err(Failure::run)?;
    if gain.certain && has_model {
        table.insert("model".into(), Value::String(MODEL.into()));
    } else {
        anchor(&mut table, &["model"], &found.folder);
    }
    anchor(&mut table, &["vehicle"], &found.folder);
    anchor(&mut table, &["security", "keys"], &found.folder);
    anchor(&mut table, &["zenoh", "config"], &found.folder);
    if gain.certain
        && let Some(Value::Table(controller)) = table.get_mut("controller")
    {
        let law = serde_json::to_value(law).map_err(Failure::run)?;
        controller.insert("law".into(), Value::String(law.as_str().unwrap_or_default().into()));
    }
    if !table.contains_key("name") {
        table.insert("name".into(), Value::String(found.name.clone()));
    }
    let head = if gain.certain { "the new law is kept" } else { "the old law is kept" };
    let text = toml::to_string(&table).map_err(Failure::run)?;
    Ok(format!("# Written by whirlstand tune; {head}: {}.\n{text}", gain.why))
}

/// Makes a path that is relative to the old launch file hold from the new one.
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
