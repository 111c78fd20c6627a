//! Presence on a bench: a small file in shared memory, locked by every member, that also holds the park
//! region.
//!
//! Each member holds a shared lock on the file; the operating system releases it however the process ends. So
//! an exclusive lock proves that no member is left, and its owner may remove all files of the bench: the last
//! member does so when it leaves, the first when it joins (a node killed while joining may have left
//! incomplete files that would block all others), and [`crate::remove_residue`] after killed ones.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

use memmap2::{MmapOptions, MmapRaw};

use crate::OpenError;
use crate::lock_file::open_lock_file;
use crate::park::Region;
use crate::residue::{clear, clear_out, is_alone, park_path};
use crate::shared_memory_space::{full, take};

/// A member's reference to the park file.
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
            let file = open_lock_file(&path).map_err(failed)?;
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
        let length = size_of::<Region>() as u64;
        take(&file, length).map_err(|e| match e.kind() {
            io::ErrorKind::StorageFull => full(bench, "the park file", length),
            _ => failed(e),
        })?;
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
