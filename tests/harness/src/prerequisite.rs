//! Prerequisites of tests on the machine.

use std::ffi::OsString;
use std::fmt;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A missing prerequisite, and its remedy.
#[derive(Debug)]
pub struct Missing {
    what: String,
    why: String,
    can_be_installed: bool,
}

impl Missing {
    /// A prerequisite that can be installed. `what` reads `no ...`, `remedy` says how to install it.
    pub fn installable(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { what: what.into(), why: remedy.into(), can_be_installed: true }
    }

    /// A prerequisite that no CI can provide on this machine, for the reason `why`.
    pub fn beyond_this_machine(what: impl Into<String>, why: impl Into<String>) -> Self {
        Self { what: what.into(), why: why.into(), can_be_installed: false }
    }

    pub(crate) fn can_be_installed(&self) -> bool {
        self.can_be_installed
    }
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.why)
    }
}

/// The folder of measured data.
///
/// # Errors
/// `WHIRLSTAND_DATA` names no folder.
pub fn data() -> Result<PathBuf, Missing> {
    let remedy = "set it to the folder of measured records";
    Ok(named("WHIRLSTAND_DATA").ok_or_else(|| Missing::installable("no WHIRLSTAND_DATA", remedy))?.into())
}

/// The Python that has the packages of `tests/requirements.txt` and `examples/python/requirements.txt`.
///
/// # Errors
/// `WHIRLSTAND_PYTHON` names no program.
pub fn python() -> Result<PathBuf, Missing> {
    let remedy =
        "set it to a Python with tests/requirements.txt and examples/python/requirements.txt installed";
    Ok(named("WHIRLSTAND_PYTHON").ok_or_else(|| Missing::installable("no WHIRLSTAND_PYTHON", remedy))?.into())
}

/// The Python of `WHIRLSTAND_PYTHON`, or `python3`, if it has a package.
///
/// # Errors
/// The program does not start or does not have the package.
pub fn python_with(package: &str) -> Result<PathBuf, Missing> {
    let python = PathBuf::from(named("WHIRLSTAND_PYTHON").unwrap_or_else(|| "python3".into()));
    let import =
        Command::new(&python).args(["-c", &format!("import {package}")]).stderr(Stdio::null()).status();
    if import.is_ok_and(|status| status.success()) {
        return Ok(python);
    }
    let what = format!("no package {package} in {}", python.display());
    Err(Missing::installable(what, "install it as .ci/run does, and set WHIRLSTAND_PYTHON to that Python"))
}

/// A headless browser that draws pages: Chromium.
///
/// # Errors
/// No Chromium is installed.
pub fn browser() -> Result<PathBuf, Missing> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let places = std::env::split_paths(&path)
        .flat_map(|folder| ["chromium", "chromium-browser", "google-chrome"].map(|name| folder.join(name)));
    let remedy = "install it, on Debian: apt-get install chromium";
    places.into_iter().find(|p| p.is_file()).ok_or_else(|| Missing::installable("no Chromium", remedy))
}

pub(crate) fn named(variable: &str) -> Option<OsString> {
    std::env::var_os(variable).filter(|value| !value.is_empty())
}
