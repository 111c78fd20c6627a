//! The folder for files that live as long as a run: locks, sockets, and the keys of benches.
//!
//! Locks and sockets are where the shared memory of benches is, and not in `XDG_RUNTIME_DIR`: that variable can
//! differ or be absent in another shell, and its folder is removed when the user logs out while a run continues.
//! Keys are in `XDG_RUNTIME_DIR` all the same, because other programs of the user look for them there; the lock
//! file records which folder it was.

use std::fs::{DirBuilder, Permissions};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use crate::error::Failure;

/// Folder of shared memory on Linux.
const SHARED_MEMORY: &str = "/dev/shm";

/// The folder of this user, made if it does not exist; no other user may read it.
///
/// # Errors
/// When it cannot be made, or its name is taken by a file of another user.
pub(crate) fn runtime_folder() -> Result<PathBuf, Failure> {
    let shared = Path::new(SHARED_MEMORY);
    let base = if shared.is_dir() { shared.to_path_buf() } else { std::env::temp_dir() };
    let user = rustix::process::geteuid().as_raw();
    private_folder(&base.join(format!("whirlstand-{user}")), user)
}

/// The user's folder for the keys of all benches, which may not exist: under `XDG_RUNTIME_DIR`, which the system
/// keeps for the user alone, or else under the temporary folder, where another user may have taken the name.
pub(super) fn keys_folder() -> PathBuf {
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|p| p.is_dir());
    match runtime {
        Some(runtime) => runtime.join("whirlstand"),
        None => {
            let user = rustix::process::geteuid().as_raw();
            std::env::temp_dir().join(format!("whirlstand-{user}"))
        }
    }
}

/// Whether this is a folder of this user, and not a link to one.
pub(super) fn is_own(path: &Path) -> bool {
    let user = rustix::process::geteuid().as_raw();
    path.symlink_metadata().is_ok_and(|found| found.is_dir() && found.uid() == user)
}

/// Makes a folder for this user alone, or removes all others' access to an existing folder of this user.
///
/// # Errors
/// As for [`runtime_folder`].
pub(crate) fn own_folder(path: &Path) -> Result<PathBuf, Failure> {
    private_folder(path, rustix::process::geteuid().as_raw())
}

fn private_folder(path: &Path, user: u32) -> Result<PathBuf, Failure> {
    match DirBuilder::new().mode(0o700).create(path) {
        Err(e) if e.kind() != ErrorKind::AlreadyExists => {
            return Err(Failure::file("make the folder", path, &e));
        }
        _ => {}
    }
    let failed = |e| Failure::file("use the folder", path, &e);
    let found = path.symlink_metadata().map_err(failed)?;
    if !found.is_dir() || found.uid() != user {
        let path = path.display();
        return Err(Failure::Mend(format!(
            "{path} does not belong to this user, but runs keep their locks and keys there: have it removed"
        )));
    }
    if found.mode() & 0o077 != 0 {
        std::fs::set_permissions(path, Permissions::from_mode(0o700)).map_err(failed)?;
    }
    Ok(path.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_own_folder_will_do_and_others_are_shut_out() {
        let base = tempfile::tempdir().unwrap();
        let user = rustix::process::geteuid().as_raw();
        let path = base.path().join("own");
        std::fs::create_dir(&path).unwrap();
        std::fs::set_permissions(&path, Permissions::from_mode(0o777)).unwrap();
        assert_eq!(private_folder(&path, user).unwrap(), path);
        assert_eq!(path.metadata().unwrap().mode() & 0o777, 0o700);

        let link = base.path().join("link");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        assert!(
            private_folder(&link, user).unwrap_err().to_string().contains("does not belong to this user")
        );
        assert!(private_folder(&path, user + 1).unwrap_err().to_string().contains("removed"));
    }
}
