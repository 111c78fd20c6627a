//! The folder with the data that programs not started by the launcher need to join a running bench. Only the user
//! of the bench can read it. It holds one Zenoh configuration for each name.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use whirlstand_bus::{BusConfig, zenoh_configuration};
use whirlstand_msgs::names::did_you_mean;

use crate::error::Failure;
use crate::exclusive::{benches_with_keys, keys_of, own_folder};

/// Time between two checks for a bench that is starting.
const LOOK: Duration = Duration::from_millis(50);

/// The folder of a running bench; it is removed when this is dropped.
pub(crate) struct BenchFolder {
    path: PathBuf,
    /// Bus configurations of the members that may join from outside.
    joiners: Vec<BusConfig>,
}

impl BenchFolder {
    /// Makes the folder, at the path of a [`Claim`](crate::exclusive::Claim) that the caller holds.
    /// [`Self::update`] then writes a configuration for each of `joiners` into it.
    ///
    /// # Errors
    /// When the user's folder cannot be trusted.
    pub fn create(path: &Path, joiners: Vec<BusConfig>) -> Result<Self, Failure> {
        path.parent().map(own_folder).transpose()?;
        match std::fs::remove_dir_all(path) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => {
                return Err(Failure::file("remove the old folder of keys", path, &e));
            }
            _ => {}
        }
        Ok(Self { path: own_folder(path)?, joiners })
    }

    /// Rewrites all configurations with the addresses on which the bench can be reached now.
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
        // A folder that stays is removed by the next bench of that name.
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

/// The configuration with which `name` joins the running bench.
///
/// # Errors
/// When no such bench runs, or it has no configuration for that name.
pub(crate) fn configuration(bench: &str, name: &str) -> Result<PathBuf, Failure> {
    let Some(folder) = keys_of(bench)?.filter(|folder| folder.is_dir()) else {
        let running = benches_with_keys()?;
        let hint = did_you_mean(bench, running.iter().map(String::as_str));
        return Err(Failure::Mend(format!(
            "no bench \"{bench}\" of yours runs over zenoh on this host{hint}: running benches are {}",
            listed(running)
        )));
    };
    let path = folder.join(file_name(name));
    if path.is_file() {
        return Ok(path);
    }
    let files = std::fs::read_dir(&folder).into_iter().flatten().flatten();
    let names = files.filter_map(|e| Some(e.file_name().to_str()?.strip_suffix(EXTENSION)?.to_string()));
    let names: Vec<String> = names.collect();
    let hint = did_you_mean(name, names.iter().map(String::as_str));
    let names = listed(names);
    Err(Failure::Mend(format!("bench \"{bench}\" has no configuration for '{name}'{hint}: it has {names}")))
}

/// As [`configuration`], for a bench that may only be starting.
///
/// # Errors
/// As [`configuration`], after the time `patience`.
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

/// Writes a file that only its owner can read, atomically: a reader finds the old text or the new one.
pub(crate) fn write_private(path: &Path, text: &str) -> io::Result<()> {
    let folder = path.parent().ok_or(io::ErrorKind::InvalidInput)?;
    // The file is made with mode 0600.
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(text.as_bytes())?;
    file.persist(path).map(|_| ()).map_err(|e| e.error)
}

fn listed(mut names: Vec<String>) -> String {
    names.sort();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::MetadataExt;

    use super::*;
    use crate::exclusive::Claim;

    #[test]
    fn benches_that_begin_at_once_leave_each_other_alone() {
        let benches: Vec<_> = (0..8)
            .map(|i| {
                std::thread::spawn(move || {
                    for round in 0..20 {
                        let bench = format!("at-once-{}-{i}-{round}", std::process::id());
                        let claim = Claim::take(&bench).unwrap();
                        let folder = BenchFolder::create(claim.keys(), Vec::new()).unwrap();
                        assert!(folder.path.is_dir(), "{bench}");
                        assert_eq!(keys_of(&bench).unwrap().as_deref(), Some(claim.keys()), "{bench}");
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
    fn what_a_killed_launcher_left_in_the_folder_is_not_taken_for_the_new_bench() {
        let bench = format!("left-{}", std::process::id());
        let claim = Claim::take(&bench).unwrap();
        drop(BenchFolder::create(claim.keys(), Vec::new()).unwrap());
        own_folder(claim.keys()).unwrap();
        std::fs::write(claim.keys().join("observer.json5"), "old").unwrap();
        let folder = BenchFolder::create(claim.keys(), Vec::new()).unwrap();
        let said = |bench: &str, name: &str| configuration(bench, name).unwrap_err().to_string();
        assert!(said(&bench, "observer").contains("it has none"));
        std::fs::write(claim.keys().join("observer.json5"), "new").unwrap();
        assert!(said(&bench, "obsrver").contains("(did you mean 'observer'?): it has observer"));
        assert!(
            said(&bench.replace("left", "lfet"), "observer").contains(&format!("(did you mean '{bench}'?)"))
        );
        drop(folder);
        assert!(!claim.keys().exists());
        drop(claim);
        assert!(configuration(&bench, "observer").unwrap_err().to_string().contains("no bench"));
    }
}
