//! Launch files: those inside the executable, and those on disk.

use std::path::{Path, PathBuf};

use whirlstand_msgs::names::{did_you_mean, nearest};

use super::document::{Document, LaunchError};
use crate::error::Failure;

/// The launch file that `whirlstand run` uses without an argument.
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
    /// Name for a bench whose file does not state one.
    pub name: String,
    /// Folder to which paths in the file are relative.
    pub folder: PathBuf,
}

/// The error for a launch file that does not exist: a name is compared with the built-in ones, a path with the
/// files beside it.
fn absent(path: &Path, text: &str, error: &std::io::Error) -> Failure {
    let is_path = path.extension().is_some() || path.components().count() > 1;
    if !is_path {
        let names = BUILTIN.iter().map(|(name, _)| *name);
        return Failure::Mend(format!(
            "there is no launch file '{text}'{}: it is neither a built-in name (`whirlstand launch list` shows all) nor a \
             file here",
            did_you_mean(text, names)
        ));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let beside: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|file| file.extension().is_some_and(|end| end == "toml"))
        .filter_map(|file| Some(file.file_stem()?.to_string_lossy().into_owned()))
        .collect();
    let wanted = path.file_stem().unwrap_or_default().to_string_lossy();
    let near = nearest(&wanted, beside.iter().map(String::as_str));
    let hint = near.map_or(String::new(), |near| {
        format!(" (did you mean '{}'?)", path.with_file_name(format!("{near}.toml")).display())
    });
    Failure::Mend(format!("cannot read the launch file {text}: {error}{hint}"))
}

/// Finds a launch file: a built-in name, or a path.
///
/// # Errors
/// When no such file exists, with the nearest built-in name; when it is not TOML.
pub(crate) fn find(name_or_path: &str) -> Result<FoundFile, Failure> {
    if let Some((name, text)) = BUILTIN.iter().find(|(name, _)| *name == name_or_path) {
        let document =
            Document::parse(&format!("built-in launch file {name}"), text).map_err(Failure::mend)?;
        return Ok(FoundFile { document, name: (*name).into(), folder: PathBuf::from(".") });
    }
    let path = Path::new(name_or_path);
    let text = std::fs::read_to_string(path).map_err(|e| absent(path, name_or_path, &e))?;
    let document = Document::parse(name_or_path, &text).map_err(|e: LaunchError| Failure::mend(e))?;
    let name = path.file_stem().map_or_else(|| "bench".into(), |s| s.to_string_lossy().into_owned());
    let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
    Ok(FoundFile { document, name, folder })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_is_compared_with_files_and_a_name_with_names() {
        let said = |text: &str| find(text).unwrap_err().to_string();
        assert!(said("quadrotor-mavlnk").contains("(did you mean 'quadrotor-mavlink'?)"));
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
        let missing = said(&path("quadrotor-mavlnk.toml"));
        assert!(
            missing.starts_with("cannot read the launch file ") && !missing.contains("did you mean"),
            "{missing}"
        );
        assert!(!said("quadrotor-mavlnk.toml").contains("'quadrotor-mavlink'"));
        std::fs::write(path("two-hosts.toml"), "").unwrap();
        let near = said(&path("two-hsts.toml"));
        assert!(near.contains(&format!("(did you mean '{}'?)", path("two-hosts.toml"))), "{near}");
    }
}
