//! Who is on a bench: a small file in shared memory, locked by every member, that also holds the park region.
//!
//! Each member holds a shared lock on the file; the operating system lets go of it however the process ends. So an
//! exclusive lock shows that nobody is left, and whoever gets it may remove everything that carries the bench's
//! name: the last member does so when it leaves, the first when it comes (a node killed while it joined may have left
//! something half made that would stop all others), and [`remove_residue`] after killed ones.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use iceoryx2::node::{Node, NodeState};
use iceoryx2::prelude::{CallbackProgression, ipc};
use memmap2::{MmapOptions, MmapRaw};

use crate::config::check_name;
use crate::park::Region;
use crate::shared_memory_config::{config, prefix, root_path};
use crate::{OpenError, ResidueError};

/// Where POSIX shared memory lives on Linux.
const SHARED_MEMORY: &str = "/dev/shm";

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
    let file = open(&path).map_err(failed)?;
    if is_alone(&file).map_err(failed)? {
        return clear_out(bench, &path);
    }
    Ok(Residue { removed: clean_dead_nodes(bench)?, in_use: true })
}

/// A member's share of the park file.
pub(crate) struct Presence {
    bench: String,
    path: PathBuf,
    file: File,
    map: MmapRaw,
}

impl Presence {
    pub(crate) fn join(bench: &str) -> Result<Self, OpenError> {
        let path = park_path(bench);
        let failed = |source| OpenError::File { path: path.clone(), source };
        let file = loop {
            let file = open(&path).map_err(failed)?;
            if is_alone(&file).map_err(failed)? {
                clear(bench, &path).map_err(OpenError::from)?;
                // All members of a fresh bench start from a park region of zeros.
                file.set_len(0).map_err(failed)?;
            }
            file.lock_shared().map_err(failed)?;
            // Somebody may have removed the file between opening and locking it.
            if file.metadata().map_err(failed)?.nlink() > 0 {
                break file;
            }
        };
        file.set_len(size_of::<Region>() as u64).map_err(failed)?;
        let map = MmapOptions::new().len(size_of::<Region>()).map_raw(&file).map_err(failed)?;
        Ok(Self { bench: bench.into(), path, file, map })
    }

    pub(crate) fn region(&self) -> &Region {
        // SAFETY: the mapping is page-aligned, at least as long as a Region (the file was set to that length and no
        // member shortens it), lives as long as `self`, and is only ever accessed as atomics, for which every bit
        // pattern is valid.
        unsafe { &*self.map.as_ptr().cast::<Region>() }
    }
}

impl Drop for Presence {
    fn drop(&mut self) {
        // A failed upgrade means that others are still there; a failed removal leaves files that the next
        // member or `remove_residue` finds, and a destructor has nobody to tell.
        if is_alone(&self.file).is_ok_and(|alone| alone)
            && let Err(error) = clear_out(&self.bench, &self.path)
        {
            tracing::warn!("leaving bench \"{}\": {error}", self.bench);
        }
    }
}

fn park_path(bench: &str) -> PathBuf {
    Path::new(SHARED_MEMORY).join(format!("{}park", prefix(bench)))
}

fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .custom_flags(libc::O_NOFOLLOW)
        .open(path)
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
fn is_alone(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(file.metadata()?.nlink() > 0),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Removes everything that carries the bench's name, the park file last, because it is the lock: a member that joins
/// meanwhile waits for it and then starts afresh. To be called with the exclusive lock held.
fn clear_out(bench: &str, park: &Path) -> Result<Residue, ResidueError> {
    let mut residue = clear(bench, park)?;
    if !residue.in_use {
        residue.removed += gone(std::fs::remove_file(park))
            .map_err(|source| ResidueError::File { path: park.into(), source })?;
    }
    Ok(residue)
}

/// Removes everything that carries the bench's name but the park file; to be called with the exclusive lock held.
fn clear(bench: &str, park: &Path) -> Result<Residue, ResidueError> {
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
