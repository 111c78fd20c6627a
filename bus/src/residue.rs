//! What killed processes leave of a bench: how it is told from what is in use, and how it is removed.

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

/// What [`remove_residue`] did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Residue {
    /// Files and folders removed, dead nodes cleaned up.
    pub removed: usize,
    /// Whether somebody is still on the bench; then only what dead nodes left was removed.
    pub in_use: bool,
}

/// Removes what killed processes left of a bench: shared memory, iceoryx2's files, the park file. Nothing of
/// another bench is touched, and nothing that a live process of this bench uses.
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
    /// Its name.
    pub bench: String,
    /// Files that it left in shared memory and beside it.
    pub files: usize,
    /// Memory and disk that they take, bytes.
    pub bytes: u64,
    /// Age of the oldest of them: when the bench began.
    pub since: SystemTime,
}

/// The bench that a file belongs to by its name.
type BenchOf = fn(&str) -> Option<&str>;

/// The benches of this user of which every process is gone and files are left; a look that changes nothing.
///
/// # Errors
/// [`ResidueError::File`] when shared memory cannot be listed.
pub fn stale_benches() -> Result<Vec<StaleBench>, ResidueError> {
    let mut names = BTreeSet::new();
    for (folder, bench_of) in [(SHARED_MEMORY, bench_of_file as BenchOf), (ROOTS, bench_of_root)] {
        let entries =
            std::fs::read_dir(folder).map_err(|source| ResidueError::File { path: folder.into(), source })?;
        let own = rustix::process::geteuid().as_raw();
        // Files of other users are theirs to remove; what vanishes meanwhile is no matter.
        let mine = |e: &std::fs::DirEntry| own == 0 || e.metadata().is_ok_and(|m| m.uid() == own);
        for entry in entries.flatten().filter(mine) {
            let name = entry.file_name();
            names.extend(name.to_str().and_then(bench_of).map(String::from));
        }
    }
    names.retain(|bench| check_name("bench", bench).is_ok() && is_stale(bench));
    Ok(names.into_iter().filter_map(|bench| measured(&bench)).collect())
}

/// Whether files are all that is left of a bench. What cannot be told counts as in use.
fn is_stale(bench: &str) -> bool {
    let left = match OpenOptions::new().read(true).write(true).open(park_path(bench)) {
        Ok(file) => is_alone(&file).unwrap_or(false),
        Err(e) => e.kind() == io::ErrorKind::NotFound,
    };
    left && nodes(bench).is_ok_and(|nodes| !nodes.iter().any(|n| matches!(n, NodeState::Alive(_))))
}

/// What is left of a bench; `None` when nothing is.
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

/// Lets iceoryx2 clean up after dead nodes while others are at work; returns how many.
fn clean_dead_nodes(bench: &str) -> Result<usize, ResidueError> {
    let cleaned = |state| match state {
        NodeState::Dead(dead) => dead.try_remove_stale_resources().is_ok(),
        NodeState::Alive(_) | NodeState::Inaccessible(_) | NodeState::Undefined(_) => false,
    };
    Ok(nodes(bench)?.into_iter().map(cleaned).filter(|cleaned| *cleaned).count())
}

/// Whether this handle now holds the exclusive lock on the file that bears the name, and nobody else is there. A
/// lock on a file that was removed meanwhile means nothing: others may have made a new one.
pub(crate) fn is_alone(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(file.metadata()?.nlink() > 0),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Removes everything that carries the bench's name, the park file last, because it is the lock: a member that joins
/// meanwhile waits for it and then starts afresh. To be called with the exclusive lock held.
pub(crate) fn clear_out(bench: &str, park: &Path) -> Result<Residue, ResidueError> {
    let mut residue = clear(bench, park)?;
    if !residue.in_use {
        residue.removed += gone(std::fs::remove_file(park))
            .map_err(|source| ResidueError::File { path: park.into(), source })?;
    }
    Ok(residue)
}

/// Removes everything that carries the bench's name but the park file; to be called with the exclusive lock held.
pub(crate) fn clear(bench: &str, park: &Path) -> Result<Residue, ResidueError> {
    if nodes(bench)?.iter().any(|state| matches!(state, NodeState::Alive(_))) {
        // A foreign iceoryx2 program, which does not lock the park file, is still on the bench.
        return Ok(Residue { removed: clean_dead_nodes(bench)?, in_use: true });
    }
    // Not iceoryx2's own cleaning, which can wait for ever on what a killed node left half made.
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

/// 1 if something was removed, 0 if it was not there.
fn gone(result: io::Result<()>) -> io::Result<usize> {
    match result {
        Ok(()) => Ok(1),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(0),
        Err(e) => Err(e),
    }
}
