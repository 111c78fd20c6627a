//! An output folder, which belongs to one run at a time.

use std::io::ErrorKind;
use std::os::fd::{AsFd, BorrowedFd};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::lock_file::{Holder, LockFile, Refused};
use crate::error::Failure;

/// Name of the lock file in the folder.
const LOCK: &str = ".whirlstand.lock";

/// A folder into which one run writes its files exclusively.
#[derive(Debug)]
pub(crate) struct OutFolder {
    path: PathBuf,
    /// `None` where the file system does not support locks.
    lock: Option<LockFile>,
}

impl OutFolder {
    /// A folder that the user named; it is created if it does not exist.
    ///
    /// # Errors
    /// When it cannot be made, or another run writes into it.
    pub fn given(path: &Path) -> Result<Self, Failure> {
        std::fs::create_dir_all(path).map_err(|e| Failure::file("make the folder", path, &e))?;
        Self::lock(path, LOCK)
    }

    /// A folder that the user named, for one of several runs that write different files into it at the same time.
    /// It is locked against another run of the same part only.
    ///
    /// # Errors
    /// When it cannot be made, or another run of the part writes into it.
    pub fn shared(path: &Path, part: &str) -> Result<Self, Failure> {
        std::fs::create_dir_all(path).map_err(|e| Failure::file("make the folder", path, &e))?;
        Self::lock(path, &format!("{LOCK}.{part}"))
    }

    /// A new folder: `out/NAME-DATE-TIME`, in UTC, with a number appended if that name exists.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn fresh(name: &str) -> Result<Self, Failure> {
        let stamp = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
        let stamp: String = stamp.trim_end_matches('Z').replace('T', "-").replace(':', "");
        let base = Path::new("out");
        std::fs::create_dir_all(base).map_err(|e| Failure::file("make the folder", base, &e))?;
        Self::lock(&make_new(base, &format!("{name}-{stamp}"))?, LOCK)
    }

    /// Absolute path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Path of the lock file.
    pub fn lock_path(&self) -> Option<&Path> {
        self.lock.as_ref().map(LockFile::path)
    }

    /// Descriptor of the lock, for a process that is to hold it too.
    pub fn lock_fd(&self) -> Option<BorrowedFd<'_>> {
        self.lock.as_ref().map(AsFd::as_fd)
    }

    fn lock(path: &Path, name: &str) -> Result<Self, Failure> {
        let path = path.canonicalize().map_err(|e| Failure::file("use the folder", path, &e))?;
        let file = path.join(name);
        let lock = match LockFile::take(&file, &Holder::here()) {
            Ok(lock) => Some(lock),
            Err(Refused::Held(holder)) => {
                return Err(Failure::Mend(format!(
                    "the run of {} is writing to the folder {}: give this run another one with --out, or wait \
                     until that run ends",
                    Refused::holder(holder.as_ref()),
                    path.display()
                )));
            }
            Err(Refused::System(e)) if knows_no_locks(&e) => {
                tracing::warn!("{}: {e}: this folder is not protected from other runs", file.display());
                None
            }
            Err(Refused::System(e)) => return Err(Failure::file("lock the folder by the file", &file, &e)),
        };
        Ok(Self { path, lock })
    }
}

/// Whether the file system does not support locks, as some network and user-space file systems.
fn knows_no_locks(error: &std::io::Error) -> bool {
    error.kind() == ErrorKind::Unsupported || error.raw_os_error() == Some(libc::ENOLCK)
}

/// Makes a new folder, with a number appended to the name if necessary.
fn make_new(base: &Path, name: &str) -> Result<PathBuf, Failure> {
    let mut path = base.join(name);
    let mut number = 1;
    loop {
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(e) if e.kind() == ErrorKind::AlreadyExists => {
                number += 1;
                path = base.join(format!("{name}-{number}"));
            }
            Err(e) => return Err(Failure::file("make the folder", &path, &e)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_run_of_the_same_second_gets_a_folder_of_its_own() {
        let base = tempfile::tempdir().unwrap();
        let made = |_| make_new(base.path(), "x").unwrap();
        let names: Vec<_> = (0..3).map(made).map(|p| p.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["x", "x-2", "x-3"]);
    }

    #[test]
    fn a_folder_in_use_is_refused_and_free_again_afterwards() {
        let base = tempfile::tempdir().unwrap();
        let first = OutFolder::given(base.path()).unwrap();
        let error = OutFolder::given(base.path()).unwrap_err().to_string();
        assert!(error.contains(&format!("process {} since ", std::process::id())), "{error}");
        drop(first);
        assert_eq!(std::fs::read_dir(base.path()).unwrap().count(), 0);
        OutFolder::given(base.path()).unwrap();
    }
}
