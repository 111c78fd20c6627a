//! A file that one process locks for as long as it lives, and that names the process.
//!
//! The lock is that of the operating system (flock(2)), so it is released however its holder ends. The contents of
//! the file are for people and for cleaning up; only the lock itself counts.

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

/// Longest wait for a living holder. A process that cleans up holds a lock for a moment only.
const TIDYING: Duration = Duration::from_millis(300);
/// Longest wait for the nodes of a killed launcher, which are being ended.
const ENDING: Duration = Duration::from_secs(10);
/// Time between two attempts.
const AGAIN: Duration = Duration::from_millis(20);

/// The holder of a lock, as the file describes it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Holder {
    /// Process number.
    pub pid: i32,
    /// When it took the lock, UTC (RFC 3339).
    pub since: String,
    /// Folder of the holder's notify sockets.
    pub sockets: Option<PathBuf>,
    /// Folder of the data that outside programs need to join the holder's bench; used over Zenoh only.
    #[serde(default)]
    pub keys: Option<PathBuf>,
}

impl Holder {
    /// This process, without any folders.
    pub fn here() -> Self {
        Self {
            pid: std::process::id() as i32,
            since: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            sockets: None,
            keys: None,
        }
    }

    /// The holder that a lock file names; `None` while the file is being written, or if there was no room to
    /// write it.
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
    /// Another process holds the lock; its description, if the file has one.
    Held(Option<Holder>),
    /// The operating system refused it.
    System(io::Error),
}

impl Refused {
    /// The holder as text.
    pub fn holder(holder: Option<&Holder>) -> String {
        holder.map_or_else(|| "another process".into(), Holder::to_string)
    }
}

/// A lock that this process holds; the file is removed when this is dropped.
#[derive(Debug)]
pub(crate) struct LockFile {
    file: File,
    path: PathBuf,
}

impl LockFile {
    /// Takes the lock and writes the holder into the file.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn take(path: &Path, holder: &Holder) -> Result<Self, Refused> {
        let began = Instant::now();
        loop {
            let mut file = open_lock_file(path).map_err(Refused::System)?;
            match file.try_lock() {
                // The previous holder may have removed the file between opening and locking.
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
                    // flock(2) either waits without a limit or not at all.
                    std::thread::sleep(AGAIN);
                }
                Err(TryLockError::Error(e)) => return Err(Refused::System(e)),
            }
        }
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the holder into the file. The lock holds even if there is no room for that.
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
        // The file is removed before the lock is released, so that nobody takes a lock on a file without a name. A
        // file that stays is taken over.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// State of a lock file, as seen by a process that does not take the lock.
enum Lock {
    /// Nobody holds the lock; the last holder, if the file names it.
    Free(Option<Holder>),
    /// A process holds the lock; the holder, if the file names it.
    Held(Option<Holder>),
}

impl Lock {
    /// Reads the state of a lock file; `None` when it does not exist or cannot be queried.
    fn of(path: &Path) -> Option<Self> {
        let mut file = OpenOptions::new().read(true).write(true).open(path).ok()?;
        match file.try_lock() {
            Ok(()) => Some(Self::Free(Holder::read(&mut file))),
            Err(TryLockError::WouldBlock) => Some(Self::Held(Holder::read(&mut file))),
            Err(TryLockError::Error(_)) => None,
        }
    }
}

/// The last holder of a free lock; `None` when the file does not exist or a process holds the lock.
pub(crate) fn last_holder(path: &Path) -> Option<Option<Holder>> {
    if let Lock::Free(last) = Lock::of(path)? { Some(last) } else { None }
}

/// The present holder of the lock; `None` when nobody holds it, or the file does not name the holder.
pub(crate) fn holder(path: &Path) -> Option<Holder> {
    if let Lock::Held(now) = Lock::of(path)? { now } else { None }
}

/// Whether a process holds the lock.
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
        let (ended, end) = std::sync::mpsc::channel();
        std::thread::spawn(move || ended.send(LockFile::take(&path, &Holder::here()).map(drop)));
        // This is longer than the wait for a living holder.
        let early = end.recv_timeout(2 * TIDYING);
        assert!(early.is_err(), "not held, or not awaited: {early:?}");
        drop(lock);
        end.recv().unwrap().unwrap();
    }
}
