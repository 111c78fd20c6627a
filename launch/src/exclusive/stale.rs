//! Files that killed runs left behind, and their removal. A bench with any living process is never touched.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Serialize;
use whirlstand_bus::{check_bench_name, remove_residue, stale_benches};

use super::claim::{claim_path, claimed_benches};
use super::lock_file::{Holder, LockFile, Refused, is_held, last_holder};
use super::runtime_folder::{is_own, keys_folder, runtime_folder};
use crate::error::Failure;

/// The files that one run left.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct StaleRun {
    /// Name of its bench.
    pub bench: String,
    /// Number of files.
    pub files: usize,
    /// Memory and disk space of the files, bytes.
    pub bytes: u64,
    /// Start time of the run, UTC (RFC 3339).
    pub since: String,
}

/// The files that runs of this user left on this machine, by bench. Nothing is changed.
///
/// # Errors
/// When shared memory cannot be listed.
pub(crate) fn stale() -> Result<Vec<StaleRun>, Failure> {
    let folder = runtime_folder()?;
    let rfc3339 = |time: SystemTime| humantime::format_rfc3339_seconds(time).to_string();
    let mut found: Vec<_> = stale_benches()
        .map_err(Failure::run)?
        .into_iter()
        // A launcher claims the name before anything of the bench exists.
        .filter(|left| !is_held(&claim_path(&folder, &left.bench)))
        .map(|left| StaleRun {
            bench: left.bench,
            files: left.files,
            bytes: left.bytes,
            since: rfc3339(left.since),
        })
        .collect();
    for bench in claimed_benches(&folder) {
        let Some(holder) = last_holder(&claim_path(&folder, &bench)) else { continue };
        let since = holder.as_ref().map_or_else(|| rfc3339(SystemTime::now()), |h| h.since.clone());
        let folders = holder.iter().flat_map(|h| [h.sockets.as_deref(), h.keys.as_deref()]).flatten();
        let left = Left { files: 1 + folders.map(files_in).sum::<usize>(), bench, since };
        left.add_to(&mut found);
    }
    // Keys outlive a claim when shared memory is lost in a restart of the machine. Where keys and claims are in
    // one folder, they do not, and the sockets are beside them.
    let keys = Some(keys_folder()).filter(|keys| is_own(keys) && *keys != folder);
    let entries = keys.and_then(|keys| std::fs::read_dir(keys).ok());
    for entry in entries.into_iter().flatten().flatten() {
        let Ok(bench) = entry.file_name().into_string() else { continue };
        let path = entry.path();
        if check_bench_name(&bench).is_ok() && is_own(&path) && !claim_path(&folder, &bench).exists() {
            let since = entry.metadata().and_then(|m| m.modified()).unwrap_or_else(|_| SystemTime::now());
            let left = Left { files: files_in(&path), bench, since: rfc3339(since) };
            left.add_to(&mut found);
        }
    }
    Ok(found)
}

/// Files of a bench besides its shared memory.
struct Left {
    bench: String,
    files: usize,
    since: String,
}

impl Left {
    fn add_to(self, found: &mut Vec<StaleRun>) {
        let Self { bench, files, since } = self;
        match found.iter_mut().find(|left| left.bench == bench) {
            Some(left) => {
                left.files += files;
                left.since = since;
            }
            None => found.push(StaleRun { bench, files, bytes: 0, since }),
        }
    }
}

fn files_in(folder: &Path) -> usize {
    std::fs::read_dir(folder).map_or(0, Iterator::count)
}

/// Removes the files that a bench left, under a claim of its name. Returns whether they were removed: not if the
/// name is in use again.
///
/// # Errors
/// When a file cannot be removed.
pub(crate) fn remove(bench: &str) -> Result<bool, Failure> {
    let folder = runtime_folder()?;
    let path = claim_path(&folder, bench);
    let last = last_holder(&path).flatten();
    let _claim = match LockFile::take(&path, &Holder::here()) {
        Ok(claim) => claim,
        Err(Refused::Held(_)) => return Ok(false),
        Err(Refused::System(e)) => {
            return Err(Failure::file("claim the bench's name by the file", &path, &e));
        }
    };
    let residue = remove_residue(bench).map_err(Failure::run)?;
    // A path in a lock file is accepted only inside the folders in which runs keep such files.
    let (sockets, keys) = last.map_or((None, None), |holder| (holder.sockets, holder.keys));
    if let Some(sockets) = sockets.filter(|s| s.parent() == Some(&folder)) {
        remove_folder(&sockets)?;
    }
    let is_of_the_bench = |keys: &PathBuf| {
        keys.parent().is_some_and(is_own)
            && is_own(keys)
            && keys.file_name().is_some_and(|name| name == bench)
    };
    let known = keys_folder().join(bench);
    for keys in keys.into_iter().chain([known]).filter(is_of_the_bench) {
        remove_folder(&keys)?;
    }
    Ok(!residue.in_use)
}

fn remove_folder(path: &Path) -> Result<(), Failure> {
    match std::fs::remove_dir_all(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
            Err(Failure::file("remove the folder", path, &e))
        }
        _ => Ok(()),
    }
}
