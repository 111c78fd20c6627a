//! The runs of one call: a launch file with the overrides of the command line, once for each of its variants.

use crate::cli::OverrideArgs;
use crate::error::Failure;

use super::builtin::{FoundFile, find};
use super::document::{Document, LaunchError, Step, at};
use super::plan::{Plan, plan};
use super::schema::{LaunchFile, VariantSection};

/// All runs of one launch file.
#[derive(Debug, Clone)]
pub(crate) struct Jobs {
    /// Name of the launch file's bench.
    pub name: String,
    /// Description of the bench in one line.
    pub description: String,
    /// The runs, one after the other.
    pub runs: Vec<Job>,
}

/// One run.
#[derive(Debug, Clone)]
pub(crate) struct Job {
    /// Name of the variant; `None` for a launch file without variants.
    pub variant: Option<String>,
    /// The bench to run.
    pub plan: Plan,
}

/// Reads a launch file (built-in name or path) with its overrides.
///
/// # Errors
/// For everything that is wrong in the file or in an override, with its place.
pub(crate) fn jobs(launch: &str, overrides: &OverrideArgs, no_log: bool) -> Result<Jobs, Failure> {
    let found = find(launch)?;
    jobs_of(&found, overrides, no_log).map_err(Failure::mend)
}

/// As [`jobs`], for a launch file that has already been found.
pub(crate) fn jobs_of(
    found: &FoundFile,
    overrides: &OverrideArgs,
    no_log: bool,
) -> Result<Jobs, LaunchError> {
    let mut document = found.document.clone();
    apply(&mut document, overrides, no_log)?;
    let file: LaunchFile = document.read()?;
    if let Some(name) = &file.name {
        check_folder_name(&document, at!["name"], name)?;
    }
    let mut runs = Vec::new();
    for (i, variant) in file.variants.iter().enumerate() {
        check_name(&document, i, &file.variants)?;
        let mut changed = found.document.clone();
        for (key, value) in flattened(&variant.set) {
            let here = document.error_at(at!["variants", i, "set", &key], "").place;
            changed.set_value(format!("{here} (variant {}, {key} = {value})", variant.name), &key, &value)?;
        }
        // The command line takes precedence over the variant.
        apply(&mut changed, overrides, no_log)?;
        let plan = plan(&changed, &found.name, &found.folder)?;
        runs.push(Job { variant: Some(variant.name.clone()), plan });
    }
    if runs.is_empty() {
        runs.push(Job { variant: None, plan: plan(&document, &found.name, &found.folder)? });
    }
    Ok(Jobs { name: file.name.unwrap_or_else(|| found.name.clone()), description: file.description, runs })
}

fn apply(document: &mut Document, overrides: &OverrideArgs, no_log: bool) -> Result<(), LaunchError> {
    let mut set = |option: String, key: &str, value: toml::Value| document.set_value(option, key, &value);
    if let Some(mode) = overrides.mode {
        set(format!("--mode {}", mode.word()), "mode", mode.word().into())?;
    }
    if let Some(transport) = overrides.transport {
        set(format!("--transport {}", transport.word()), "transport", transport.word().into())?;
    }
    if let Some(duration) = overrides.duration {
        set(format!("--duration {duration}"), "duration_s", duration.into())?;
    }
    if let Some(seed) = overrides.seed {
        let value = i64::try_from(seed).map_err(|_| LaunchError {
            place: format!("--seed {seed}"),
            message: format!("a seed up to {} is expected", i64::MAX),
        })?;
        set(format!("--seed {seed}"), "seed", value.into())?;
    }
    if let Some(timeout) = overrides.answer_timeout {
        set(format!("--answer-timeout {timeout}"), "plant.answer_timeout_s", timeout.into())?;
    }
    if no_log {
        set("--no-log".into(), "recorder.enabled", false.into())?;
    }
    overrides.set.iter().try_for_each(|assignment| document.set("--set", assignment))
}

fn check_name(document: &Document, i: usize, variants: &[VariantSection]) -> Result<(), LaunchError> {
    let name = &variants[i].name;
    let here = at!["variants", i, "name"];
    check_folder_name(document, here, name)?;
    if variants[..i].iter().any(|v| v.name == *name) {
        return Err(document.error_at(here, format!("another variant is called '{name}': names must differ")));
    }
    Ok(())
}

/// A name that becomes a folder must not lead out of its parent folder.
fn check_folder_name(document: &Document, here: &[Step<'_>], name: &str) -> Result<(), LaunchError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if !name.is_empty() && !name.starts_with('.') && name.len() <= 64 && name.chars().all(allowed) {
        return Ok(());
    }
    let message = format!(
        "'{}' names a folder: up to 64 letters, digits, '_', '-' or '.' are expected, '.' not first",
        name.escape_debug()
    );
    Err(document.error_at(here, message))
}

/// Dotted keys and values of a variant's `set`. Nested tables are flattened, so that they change single keys.
fn flattened(table: &toml::Table) -> Vec<(String, toml::Value)> {
    let mut flat = Vec::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) if !inner.is_empty() => {
                flat.extend(flattened(inner).into_iter().map(|(rest, v)| (format!("{key}.{rest}"), v)));
            }
            value => flat.push((key.clone(), value.clone())),
        }
    }
    flat
}
