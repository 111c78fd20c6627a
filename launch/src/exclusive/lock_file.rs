//! A file that one process holds for as long as it lives, and that says who it is.
//!
//! The lock is the operating system's (flock(2)), so it is free however its holder ends. What is written in the file is for
//! people and for tidying up; that it is locked is what counts.

use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use serde::{Deserialize, Serialize};
use whirlstand_bus::open_lock_file;

use crate::proc_stat::ProcStat;

/// How long to wait for a living holder: whoever tidies up holds a lock for a moment only.
const TIDYING: Duration = Duration::from_millis(300);
/// How long to wait for the nodes of a killed launcher, which are being ended.
const ENDING: Duration = Duration::from_secs(10);
/// Time between two attempts.
const AGAIN: Duration = Duration::from_millis(20);

/// Who holds a lock.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Holder {
    /// Process number.
    pub pid: i32,
    /// When it took the lock, UTC (RFC 3339).
    pub since: String,
    /// Folder of its notify sockets.
    pub sockets: Option<PathBuf>,
    /// Folder of what outside programs need to join its bench; made over Zenoh only.
    #[serde(default)]
    pub keys: Option<PathBuf>,
}

impl Holder {
    /// This process, with nothing beside its lock.
    pub fn here() -> Self {
        Self {
            pid: std::process::id() as i32,
            since: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            sockets: None,
            keys: None,
        }
    }

    /// Who a lock file names; `None` while it is being written, or if there was no room to write.
    pub fn read(file: &mut File) -> Option<Self> {
        let mut text = String::new();
        file.rewind().ok()?;
        file.read_to_string(&mut text).ok()?;
        serde_json::from_str(&text).ok()
    }
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "process {} since {}", self.pid, self.since)
    }
}

/// Why a lock was not given.
#[derive(Debug)]
pub(crate) enum Refused {
    /// By somebody else, who says who it is.
    Held(Option<Holder>),
    /// By the operating system.
    System(io::Error),
}

impl Refused {
    /// The holder as text.
    pub fn holder(holder: Option<&Holder>) -> String {
        holder.map_or_else(|| "another process".into(), Holder::to_string)
    }
}

/// A lock that this process holds; the file goes with it.
#[derive(Debug)]
pub(crate) struct LockFile {
    file: File,
    path: PathBuf,
}

impl LockFile {
    /// Takes the lock and signs the file.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn take(path: &Path, holder: &Holder) -> Result<Self, Refused> {
        let began = Instant::now();
        loop {
            let mut file = open_lock_file(path).map_err(Refused::System)?;
            match file.try_lock() {
                // Who let go of it may have removed it between opening and locking.
                Ok(()) if file.metadata().map_err(Refused::System)?.nlink() == 0 => {}
                Ok(()) => {
                    let mut lock = Self { file, path: path.into() };
                    lock.sign(holder);
                    return Ok(lock);
                }
                Err(TryLockError::WouldBlock) => {
                    let held_by = Holder::read(&mut file);
                    let gone = held_by.as_ref().is_some_and(|h| ProcStat::of(h.pid).is_none());
                    if began.elapsed() > if gone { ENDING } else { TIDYING } {
                        return Err(Refused::Held(held_by));
                    }
                    std::thread::sleep(AGAIN);
                }
                Err(TryLockError::Error(e)) => return Err(Refused::System(e)),
            }
        }
    }

    /// Where the file is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the holder into the file. Without room for that the lock holds all the same.
    fn sign(&mut self, holder: &Holder) {
        let written = serde_json::to_string(holder).map_err(io::Error::from).and_then(|text| {
            self.file.set_len(0)?;
            self.file.rewind()?;
            self.file.write_all(text.as_bytes())
        });
        if let Err(e) = written {
            tracing::debug!("{}: {e}", self.path.display());
        }
    }
}

impl AsFd for LockFile {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl Drop for LockFile {
    fn drop(&mut self) {
        // Removed before it is let go, so that nobody takes a lock on a file without a name. One that stays is taken over.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// What a lock file tells those who do not take the lock.
enum Lock {
    /// Nobody holds it; who held it last, if the file says so.
    Free(Option<Holder>),
    /// Somebody holds it; who, if the file says so.
    Held(Option<Holder>),
}

impl Lock {
    /// Looks at a lock file; `None` when it is not there or cannot be asked.
    fn of(path: &Path) -> Option<Self> {
        let mut file = OpenOptions::new().read(true).write(true).open(path).ok()?;
        match file.try_lock() {
            Ok(()) => Some(Self::Free(Holder::read(&mut file))),
            Err(TryLockError::WouldBlock) => Some(Self::Held(Holder::read(&mut file))),
            Err(TryLockError::Error(_)) => None,
        }
    }
}

/// Who held the lock last; `None` when the file is not there or somebody holds it.
pub(crate) fn last_holder(path: &Path) -> Option<Option<Holder>> {
    if let Lock::Free(last) = Lock::of(path)? { Some(last) } else { None }
}

/// Who holds the lock now; `None` when nobody does, or nothing says who.
pub(crate) fn holder(path: &Path) -> Option<Holder> {
    if let Lock::Held(now) = Lock::of(path)? { now } else { None }
}

/// Whether somebody holds the lock.
pub(crate) fn is_held(path: &Path) -> bool {
    matches!(Lock::of(path), Some(Lock::Held(_)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_at_a_time_holds_it_and_the_other_learns_who() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.lock");
        let here = Holder::here();
        let lock = LockFile::take(&path, &here).unwrap();
        assert!(is_held(&path) && last_holder(&path).is_none());
        assert_eq!(super::holder(&path).as_ref(), Some(&here));
        match LockFile::take(&path, &here) {
            Err(Refused::Held(Some(holder))) => assert_eq!(holder, here),
            other => panic!("{other:?}"),
        }
        drop(lock);
        assert!(!path.exists() && !is_held(&path));
        LockFile::take(&path, &here).unwrap();
    }

    #[test]
    fn a_file_that_a_killed_process_left_is_taken_over_whatever_is_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.lock");
        std::fs::write(&path, "no JSON, and longer than what will be written into it".repeat(9)).unwrap();
        assert_eq!(last_holder(&path), Some(None));
        let mut lock = LockFile::take(&path, &Holder::here()).unwrap();
        assert_eq!(Holder::read(&mut lock.file).unwrap().pid, std::process::id() as i32);
    }

    #[test]
    fn a_lock_is_awaited_while_the_nodes_of_a_dead_holder_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.lock");
        let mut dead = std::process::Command::new("true").spawn().unwrap();
        dead.wait().unwrap();
        let signed = Holder { pid: dead.id() as i32, ..Holder::here() };
        let lock = LockFile::take(&path, &signed).unwrap();
        let waiting = std::thread::spawn({
            let path = path.clone();
            move || LockFile::take(&path, &Holder::here()).map(drop)
        });
        // Longer than a living holder is waited for.
        std::thread::sleep(2 * TIDYING);
        drop(lock);
        waiting.join().unwrap().unwrap();
    }
}
