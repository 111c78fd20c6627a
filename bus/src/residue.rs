//! Leftover files of killed processes: how they are distinguished from those in use, and how they are
//! removed.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::{CallbackProgression, ipc};

use crate::ResidueError;
use crate::config::check_name;
use crate::lock_file::open_lock_file;
use crate::shared_memory_config::{
    ROOTS, SHARED_MEMORY, bench_of_file, bench_of_root, config, prefix, root_path,
};

/// Result of [`remove_residue`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Residue {
    /// Number of files and folders removed and dead nodes cleaned up.
    pub removed: usize,
    /// True when a process still uses the bench; then only files of dead nodes were removed.
    pub in_use: bool,
}

/// Removes leftover files of killed processes on a bench: shared memory, iceoryx2's files, the park file.
/// Files of other benches and of live processes are not touched.
///
/// # Errors
/// [`ResidueError`] when a file cannot be removed, for example because it belongs to another user.
pub fn remove_residue(bench: &str) -> Result<Residue, ResidueError> {
    check_name("bench", bench).map_err(ResidueError::Name)?;
    let path = park_path(bench);
    let failed = |source| ResidueError::File { path: path.clone(), source };
    let file = open_lock_file(&path).map_err(failed)?;
    if is_alone(&file).map_err(failed)? {
        return clear_out(bench, &path);
    }
    Ok(Residue { removed: clean_dead_nodes(bench)?, in_use: true })
}

/// A bench of which only files are left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StaleBench {
    /// Name of the bench.
    pub bench: String,
    /// Number of its files in shared memory and beside it.
    pub files: usize,
    /// Memory and disk space of its files, bytes.
    pub bytes: u64,
    /// Time of the oldest file, when the bench began.
    pub since: SystemTime,
}

/// Function that returns the bench of a file by the file's name.
type BenchOf = fn(&str) -> Option<&str>;

/// Benches of this user with leftover files and no process; reads only.
///
/// # Errors
/// [`ResidueError::File`] when shared memory cannot be listed.
pub fn stale_benches() -> Result<Vec<StaleBench>, ResidueError> {
    let mut names = BTreeSet::new();
    for (folder, bench_of) in [(SHARED_MEMORY, bench_of_file as BenchOf), (ROOTS, bench_of_root)] {
        let entries =
            std::fs::read_dir(folder).map_err(|source| ResidueError::File { path: folder.into(), source })?;
        let own = rustix::process::geteuid().as_raw();
        // Files of other users are not considered; files that vanish meanwhile are ignored.
        let mine = |e: &std::fs::DirEntry| own == 0 || e.metadata().is_ok_and(|m| m.uid() == own);
        for entry in entries.flatten().filter(mine) {
            let name = entry.file_name();
            names.extend(name.to_str().and_then(bench_of).map(String::from));
        }
    }
    names.retain(|bench| check_name("bench", bench).is_ok() && is_stale(bench));
    Ok(names.into_iter().filter_map(|bench| measured(&bench)).collect())
}

/// True when a bench has only files left. An undecidable case counts as in use.
fn is_stale(bench: &str) -> bool {
    let left = match OpenOptions::new().read(true).write(true).open(park_path(bench)) {
        Ok(file) => is_alone(&file).unwrap_or(false),
        Err(e) => e.kind() == io::ErrorKind::NotFound,
    };
    left && nodes(bench).is_ok_and(|nodes| !nodes.iter().any(|n| matches!(n, NodeState::Alive(_))))
}

/// Leftover files of a bench; `None` without any.
fn measured(bench: &str) -> Option<StaleBench> {
    let prefix = prefix(bench);
    let shared = std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten();
    let mut found: Vec<_> =
        shared.filter(|e| e.file_name().as_encoded_bytes().starts_with(prefix.as_bytes())).collect();
    let mut folders = vec![root_path(bench)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                folders.push(entry.path());
            } else {
                found.push(entry);
            }
        }
    }
    let metadata: Vec<_> = found.iter().filter_map(|e| e.metadata().ok()).collect();
    let root = std::fs::metadata(root_path(bench)).ok();
    let since = metadata.iter().chain(&root).filter_map(|m| m.modified().ok()).min()?;
    // stat(2) counts blocks of 512 bytes, whatever the file system's own are.
    let bytes = metadata.iter().map(|m| m.blocks() * 512).sum();
    Some(StaleBench { bench: bench.into(), files: metadata.len(), bytes, since })
}

pub(crate) fn park_path(bench: &str) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{}park", prefix(bench)))
}

/// The iceoryx2 nodes of a bench, dead or alive.
fn nodes(bench: &str) -> Result<Vec<NodeState<ipc::Service>>, ResidueError> {
    let config = config(bench).map_err(ResidueError::Name)?;
    let mut nodes = Vec::new();
    Node::<ipc::Service>::list(&config, |state| {
        nodes.push(state);
        CallbackProgression::Continue
    })
    .map_err(|e| ResidueError::List { bench: bench.into(), reason: e.to_string() })?;
    Ok(nodes)
}

/// Lets iceoryx2 clean up after dead nodes while others are running; returns their number.
fn clean_dead_nodes(bench: &str) -> Result<usize, ResidueError> {
    let cleaned = |state| match state {
        NodeState::Dead(dead) => dead.try_remove_stale_resources().is_ok(),
        NodeState::Alive(_) | NodeState::Inaccessible(_) | NodeState::Undefined(_) => false,
    };
    Ok(nodes(bench)?.into_iter().map(cleaned).filter(|cleaned| *cleaned).count())
}

/// True when this handle holds the exclusive lock on the file with this name, so that no other member exists.
/// A lock on a file that was removed meanwhile is invalid: others may have created a new one.
pub(crate) fn is_alone(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(file.metadata()?.nlink() > 0),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Removes all files with the bench's name, the park file last, because it is the lock: a member that joins
/// meanwhile waits for it and then starts afresh. To be called with the exclusive lock held.
pub(crate) fn clear_out(bench: &str, park: &Path) -> Result<Residue, ResidueError> {
    let mut residue = clear(bench, park)?;
    if !residue.in_use {
        residue.removed += gone(std::fs::remove_file(park))
            .map_err(|source| ResidueError::File { path: park.into(), source })?;
    }
    Ok(residue)
}

/// Removes all files with the bench's name except the park file; to be called with the exclusive lock held.
pub(crate) fn clear(bench: &str, park: &Path) -> Result<Residue, ResidueError> {
    if nodes(bench)?.iter().any(|state| matches!(state, NodeState::Alive(_))) {
        // A foreign iceoryx2 program, which does not lock the park file, still uses the bench.
        return Ok(Residue { removed: clean_dead_nodes(bench)?, in_use: true });
    }
    // iceoryx2's own cleaning is avoided, as it can block forever on incomplete files of a killed node.
    let mut removed = 0;
    let failed = |path: &Path, source: io::Error| ResidueError::File { path: path.into(), source };
    let shared = Path::new(SHARED_MEMORY);
    let prefix = prefix(bench);
    for entry in std::fs::read_dir(shared).map_err(|e| failed(shared, e))?.flatten() {
        let path = entry.path();
        if entry.file_name().as_encoded_bytes().starts_with(prefix.as_bytes()) && path != park {
            removed += gone(std::fs::remove_file(&path)).map_err(|e| failed(&path, e))?;
        }
    }
    let root = root_path(bench);
    removed += gone(std::fs::remove_dir_all(&root)).map_err(|e| failed(&root, e))?;
    Ok(Residue { removed, in_use: false })
}

/// Number of removed files: 1, or 0 if it did not exist.
fn gone(result: io::Result<()>) -> io::Result<usize> {
    match result {
        Ok(()) => Ok(1),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(0),
        Err(e) => Err(e),
    }
}
