//! A bench's name belongs to one launcher of this user on this machine at a time.

use std::os::fd::{AsFd, BorrowedFd};
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use whirlstand_bus::check_bench_name;

use super::lock_file::{Holder, LockFile, Refused, holder};
use super::runtime_folder::{keys_folder, runtime_folder};
use crate::error::Failure;

/// Suffix of a claim's file.
const SUFFIX: &str = ".lock";

/// The right to run a bench under its name, and the folder for its sockets.
#[derive(Debug)]
pub(crate) struct Claim {
    bench: String,
    // The fields are dropped in this order: nobody can claim the name before the sockets are removed.
    sockets: TempDir,
    keys: PathBuf,
    lock: LockFile,
}

impl Claim {
    /// Claims a bench.
    ///
    /// # Errors
    /// When the name is invalid, or another launcher runs the bench.
    pub fn take(bench: &str) -> Result<Self, Failure> {
        check_bench_name(bench).map_err(Failure::mend)?;
        let folder = runtime_folder()?;
        // The path is short, because the address of a socket has room for 107 bytes.
        let sockets = tempfile::Builder::new()
            .prefix("s")
            .tempdir_in(&folder)
            .map_err(|e| Failure::file("make a folder for sockets in", &folder, &e))?;
        let path = claim_path(&folder, bench);
        let keys = keys_folder().join(bench);
        let holder =
            Holder { sockets: Some(sockets.path().into()), keys: Some(keys.clone()), ..Holder::here() };
        let lock = LockFile::take(&path, &holder).map_err(|e| match e {
            Refused::Held(holder) => Failure::Mend(format!(
                "the bench '{bench}' is already running in {}: give this run another name with --bench, or wait \
                 until that run ends",
                Refused::holder(holder.as_ref())
            )),
            Refused::System(e) => Failure::file("claim the bench's name by the file", &path, &e),
        })?;
        Ok(Self { bench: bench.into(), sockets, keys, lock })
    }

    /// Name of the bench.
    pub fn bench(&self) -> &str {
        &self.bench
    }

    /// The folder for its notify sockets.
    pub fn sockets(&self) -> &Path {
        self.sockets.path()
    }

    /// The folder for the data with which outside programs join the bench. Only the holder of the claim may
    /// make or remove it.
    pub fn keys(&self) -> &Path {
        &self.keys
    }

    /// The lock file of the claim.
    pub fn path(&self) -> &Path {
        self.lock.path()
    }
}

impl AsFd for Claim {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.lock.as_fd()
    }
}

/// The folder for the sockets of a running bench of this user; `None` when no launcher runs it.
///
/// # Errors
/// When the name cannot be that of a bench, or the user's folder cannot be used.
pub(crate) fn sockets_of(bench: &str) -> Result<Option<PathBuf>, Failure> {
    check_bench_name(bench).map_err(Failure::mend)?;
    Ok(holder(&claim_path(&runtime_folder()?, bench)).and_then(|holder| holder.sockets))
}

/// Names of the benches that launchers of this user run on this machine.
///
/// # Errors
/// When the user's folder cannot be used.
pub(crate) fn running_benches() -> Result<Vec<String>, Failure> {
    let folder = runtime_folder()?;
    let mut all = claimed_benches(&folder);
    all.retain(|bench| holder(&claim_path(&folder, bench)).is_some());
    Ok(all)
}

/// The folder with the data that outside programs need to join a running bench; `None` when no launcher of this
/// user runs it.
///
/// # Errors
/// When the user's folder cannot be used.
pub(crate) fn keys_of(bench: &str) -> Result<Option<PathBuf>, Failure> {
    Ok(holder(&claim_path(&runtime_folder()?, bench)).and_then(|holder| holder.keys))
}

/// Names of the running benches of this user that have keys.
///
/// # Errors
/// When the user's folder cannot be used.
pub(crate) fn benches_with_keys() -> Result<Vec<String>, Failure> {
    let folder = runtime_folder()?;
    let has_keys = |bench: &String| {
        holder(&claim_path(&folder, bench)).and_then(|holder| holder.keys).is_some_and(|keys| keys.is_dir())
    };
    Ok(claimed_benches(&folder).into_iter().filter(has_keys).collect())
}

/// The lock file of the claim of a bench.
pub(super) fn claim_path(folder: &Path, bench: &str) -> PathBuf {
    folder.join(format!("{bench}{SUFFIX}"))
}

/// Names of the benches that are or were claimed.
pub(super) fn claimed_benches(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut all: Vec<_> =
        entries.filter_map(|e| Some(e.file_name().to_str()?.strip_suffix(SUFFIX)?.to_string())).collect();
    all.sort();
    all
}
