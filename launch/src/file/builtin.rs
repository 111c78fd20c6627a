//! Launch files: those inside the executable, and those on disk.

use std::path::{Path, PathBuf};

use whirlstand_msgs::names::did_you_mean;

use super::document::{Document, LaunchError};
use crate::error::Failure;

/// The launch file that `whirlstand run` takes without an argument.
pub(crate) const DEFAULT: &str = "quadrotor";

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../files/", $name, ".toml")))),*]
    };
}

/// Name and text of every built-in launch file.
pub(crate) const BUILTIN: &[(&str, &str)] = files![
    "quadrotor",
    "quadrotor-smc",
    "quadrotor-lqr",
    "quadrotor-ppc",
    "quadrotor-compare",
    "quadrotor-mavlink",
    "quadrotor-crsf",
    "quadrotor-px4",
    "quadrotor-ardupilot",
    "helicopter-hover-smc",
    "helicopter-hover-lqr",
    "helicopter-hover-ppc",
    "helicopter-hover-compare",
    "helicopter-longitudinal-smc",
    "helicopter-longitudinal-lqr",
    "helicopter-longitudinal-ppc",
    "helicopter-lateral-smc",
    "helicopter-lateral-lqr",
    "helicopter-lateral-ppc",
];

/// A launch file that was found, not yet read.
#[derive(Debug, Clone)]
pub(crate) struct FoundFile {
    /// The document.
    pub document: Document,
    /// Name for a bench whose file states none.
    pub name: String,
    /// Folder that paths in the file are relative to.
    pub folder: PathBuf,
}

/// Finds a launch file: a built-in name, or a path.
///
/// # Errors
/// When there is no such file, with the nearest built-in name; when it is not TOML.
pub(crate) fn find(name_or_path: &str) -> Result<FoundFile, Failure> {
    if let Some((name, text)) = BUILTIN.iter().find(|(name, _)| *name == name_or_path) {
        let document =
            Document::parse(&format!("built-in launch file {name}"), text).map_err(Failure::mend)?;
        return Ok(FoundFile { document, name: (*name).into(), folder: PathBuf::from(".") });
    }
    let path = Path::new(name_or_path);
    let text = std::fs::read_to_string(path).map_err(|e| {
        let names = || BUILTIN.iter().map(|(n, _)| *n);
        Failure::Mend(format!(
            "cannot read the launch file {name_or_path}: {e}; give a path or a built-in name{}; \
             `whirlstand launch list` shows all",
            did_you_mean(name_or_path, names()),
        ))
    })?;
    let document = Document::parse(name_or_path, &text).map_err(|e: LaunchError| Failure::mend(e))?;
    let name = path.file_stem().map_or_else(|| "bench".into(), |s| s.to_string_lossy().into_owned());
    let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
    Ok(FoundFile { document, name, folder })
}
