//! Keys for several hosts, as files: `ca.pem`, and `NAME.pem` and `NAME.key` for each member.

use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use whirlstand_bus::{Authority, Identity};

use crate::error::Failure;

/// The authority's certificate.
const AUTHORITY: &str = "ca.pem";

/// A missing file in a folder of keys.
#[derive(Debug, thiserror::Error)]
#[error("{path} cannot be read ({source}): make keys with `whirlstand keys new`, and copy {name}.pem, {name}.key and ca.pem \
         to the host on which '{name}' runs", path = path.display())]
pub(crate) struct Gap {
    path: PathBuf,
    name: String,
    source: std::io::Error,
}

/// A folder of keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct KeyFolder(pub PathBuf);

impl KeyFolder {
    /// The key and certificate of one member.
    ///
    /// # Errors
    /// For a file that is missing.
    pub fn identity(&self, name: &str) -> Result<Identity, Gap> {
        let read = |file: String| {
            let path = self.0.join(file);
            std::fs::read_to_string(&path).map_err(|source| Gap { path, name: name.into(), source })
        };
        Ok(Identity {
            authority: read(AUTHORITY.into())?,
            certificate: read(format!("{name}.pem"))?,
            key: read(format!("{name}.key"))?,
        })
    }

    /// Makes a folder with keys for `names`, valid on `hosts`.
    ///
    /// # Errors
    /// For a folder that exists and is not empty, and for a host that is neither a DNS name nor an IP address.
    pub fn make(folder: &Path, names: &[String], hosts: &[String]) -> Result<(), Failure> {
        let failed = |path: &Path, e| Failure::file("make the key file", path, &e);
        std::fs::DirBuilder::new()
            .recursive(true)
            .mode(0o700)
            .create(folder)
            .map_err(|e| Failure::file("make the folder", folder, &e))?;
        let mut content =
            std::fs::read_dir(folder).map_err(|e| Failure::file("use the folder", folder, &e))?;
        if content.next().is_some() {
            return Err(Failure::Mend(format!(
                "{} is not empty: keys are never overwritten; give a new folder",
                folder.display()
            )));
        }
        let authority = Authority::new("keys").map_err(Failure::run)?;
        let write = |file: String, text: &str, mode: u32| {
            let path = folder.join(file);
            let made = OpenOptions::new().write(true).create_new(true).mode(mode).open(&path);
            made.and_then(|mut f| f.write_all(text.as_bytes())).map_err(|e| failed(&path, e))
        };
        for name in names {
            let identity = authority.issue(name, hosts).map_err(Failure::mend)?;
            write(format!("{name}.pem"), &identity.certificate, 0o644)?;
            write(format!("{name}.key"), &identity.key, 0o600)?;
        }
        // The authority's certificate is written last: a folder without it is incomplete.
        write(AUTHORITY.into(), &authority.certificate(), 0o644)
    }
}
