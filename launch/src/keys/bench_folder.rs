//! Where programs that the launcher does not start find what they need to join a running bench: a folder that only the
//! user of the bench can read, with one Zenoh configuration for each name.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use whirlstand_bus::{BusConfig, zenoh_configuration};

use crate::error::Failure;

/// Held by the launcher of a running bench; a folder without its holder is left over.
const LOCK: &str = "lock";

/// Time between two looks for a bench that is about to begin.
const LOOK: Duration = Duration::from_millis(50);

/// The folder of a running bench; it goes with the launcher.
pub(crate) struct BenchFolder {
    path: PathBuf,
    _lock: File,
    /// Whom it has a configuration for.
    joiners: Vec<BusConfig>,
}

impl BenchFolder {
    /// Makes the folder of a bench; [`Self::update`] then fills it with a configuration for each of `joiners`.
    ///
    /// # Errors
    /// When the bench runs already, or the user's folder cannot be trusted.
    pub fn create(bench: &str, joiners: Vec<BusConfig>) -> Result<Self, Failure> {
        let base = base().map_err(|(path, e)| Failure::file("keep the keys of benches in", &path, &e))?;
        // Nobody sweeps a folder that has been made and is not locked yet.
        let _turn = turn(&base).map_err(|e| Failure::file("keep the keys of benches in", &base, &e))?;
        sweep(&base);
        let path = base.join(bench);
        let failed = |e: io::Error| Failure::file("keep the keys of the bench in", &path, &e);
        private_folder(&path).map_err(failed)?;
        let lock = lock_file(&path).map_err(failed)?;
        if lock.try_lock().is_err() {
            return Err(Failure::Mend(format!(
                "a bench \"{bench}\" of yours runs already: give this one another name with --bench"
            )));
        }
        Ok(Self { path, _lock: lock, joiners })
    }

    /// Writes all configurations anew, with the addresses on which the bench can be reached now.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn update(&self, locators: &[String]) -> Result<(), Failure> {
        for joiner in &self.joiners {
            let mut joiner = joiner.clone();
            joiner.zenoh.connect.extend(locators.iter().cloned());
            let text = zenoh_configuration(&joiner).map_err(Failure::mend)?;
            let path = self.path.join(file_name(&joiner.node));
            write_private(&path, &text).map_err(|e| Failure::file("write", &path, &e))?;
        }
        Ok(())
    }
}

impl Drop for BenchFolder {
    fn drop(&mut self) {
        // What stays is swept by the next bench.
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

/// The configuration with which `name` joins the running bench.
///
/// # Errors
/// When no such bench runs, or it has no such name.
pub(crate) fn configuration(bench: &str, name: &str) -> Result<PathBuf, Failure> {
    let base = base().map_err(|(path, e)| Failure::file("look for keys in", &path, &e))?;
    let path = base.join(bench).join(file_name(name));
    if path.is_file() {
        return Ok(path);
    }
    let missing = if !base.join(bench).is_dir() {
        format!(
            "no bench \"{bench}\" of yours runs over zenoh on this host: running are {}",
            listed(&base, |_| true)
        )
    } else {
        let is_configuration = |file: &str| file.ends_with(EXTENSION);
        format!(
            "bench \"{bench}\" has no configuration for '{name}': it has {}",
            listed(&base.join(bench), is_configuration)
        )
    };
    Err(Failure::Mend(missing))
}

/// As [`configuration`], for a bench that may be about to begin.
///
/// # Errors
/// As [`configuration`], once `patience` is over.
pub(crate) fn await_configuration(bench: &str, name: &str, patience: Duration) -> Result<PathBuf, Failure> {
    let until = Instant::now() + patience;
    loop {
        match configuration(bench, name) {
            Err(_) if Instant::now() < until => std::thread::sleep(LOOK),
            result => return result,
        }
    }
}

const EXTENSION: &str = ".json5";

fn file_name(name: &str) -> String {
    format!("{name}{EXTENSION}")
}

/// Writes a file that only its owner can read, in one step: a reader finds the old text or the new one.
pub(crate) fn write_private(path: &Path, text: &str) -> io::Result<()> {
    let folder = path.parent().ok_or(io::ErrorKind::InvalidInput)?;
    // Made with mode 0600.
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(text.as_bytes())?;
    file.persist(path).map(|_| ()).map_err(|e| e.error)
}

fn listed(folder: &Path, wanted: impl Fn(&str) -> bool) -> String {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|e| e.file_name().to_string_lossy().into_owned()).filter(|n| wanted(n));
    let mut names: Vec<String> = names.map(|n| n.trim_end_matches(EXTENSION).to_string()).collect();
    names.sort();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// The user's folder for all benches: under `XDG_RUNTIME_DIR`, which the system keeps for the user alone, or else under the
/// temporary folder, where somebody else may have been first.
fn base() -> Result<PathBuf, (PathBuf, io::Error)> {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|p| p.is_dir());
    let path = match runtime {
        Some(runtime) => runtime.join("whirlstand"),
        None => std::env::temp_dir().join(format!("whirlstand-{}", rustix::process::geteuid().as_raw())),
    };
    private_folder(&path).map_err(|e| (path.clone(), e)).map(|()| path)
}

/// Makes a folder for this user alone, or checks that it is one.
fn private_folder(path: &Path) -> io::Result<()> {
    match std::fs::DirBuilder::new().mode(0o700).create(path) {
        Err(e) if e.kind() != io::ErrorKind::AlreadyExists => return Err(e),
        _ => {}
    }
    // Not through a link that somebody else has laid.
    let found = std::fs::symlink_metadata(path)?;
    if found.is_dir() && found.uid() == rustix::process::geteuid().as_raw() && found.mode() & 0o077 == 0 {
        return Ok(());
    }
    Err(io::Error::other(
        "it is not a folder of this user that is closed to all others (mode 0700): remove it, or set XDG_RUNTIME_DIR to one",
    ))
}

fn lock_file(folder: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create(true).truncate(false).mode(0o600).open(folder.join(LOCK))
}

/// The right to make and to remove folders of benches, until it is dropped.
fn turn(base: &Path) -> io::Result<File> {
    let lock = lock_file(base)?;
    lock.lock()?;
    Ok(lock)
}

/// Removes the folders of launchers that were killed; to be called with the [`turn`].
fn sweep(base: &Path) {
    for entry in std::fs::read_dir(base).into_iter().flatten().flatten() {
        let folder = entry.path();
        let Ok(lock) = File::open(folder.join(LOCK)) else { continue };
        if lock.try_lock().is_ok() {
            let _ = std::fs::remove_dir_all(&folder);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_folder_that_others_can_open_is_not_used() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keys");
        private_folder(&path).unwrap();
        private_folder(&path).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        assert!(private_folder(&path).unwrap_err().to_string().contains("0700"));
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path(), &link).unwrap();
        assert!(private_folder(&link).is_err());
    }

    #[test]
    fn benches_that_begin_at_once_leave_each_other_alone() {
        let benches: Vec<_> = (0..8)
            .map(|i| {
                std::thread::spawn(move || {
                    for round in 0..50 {
                        let bench = format!("at-once-{}-{i}-{round}", std::process::id());
                        let folder = BenchFolder::create(&bench, Vec::new()).unwrap();
                        assert!(folder.path.is_dir(), "{bench}");
                    }
                })
            })
            .collect();
        benches.into_iter().for_each(|bench| bench.join().unwrap());
    }

    #[test]
    fn a_configuration_is_readable_by_its_owner_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        for text in ["one", "two"] {
            write_private(&path, text).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
            assert_eq!(std::fs::metadata(&path).unwrap().mode() & 0o777, 0o600);
        }
    }

    #[test]
    fn what_a_killed_launcher_left_is_swept() {
        let base = tempfile::tempdir().unwrap();
        for name in ["left", "held"] {
            private_folder(&base.path().join(name)).unwrap();
        }
        let _left = lock_file(&base.path().join("left")).unwrap();
        let held = lock_file(&base.path().join("held")).unwrap();
        held.try_lock().unwrap();
        sweep(base.path());
        assert!(!base.path().join("left").exists() && base.path().join("held").exists());
    }
}
