//! Reservation of space in shared memory.
//!
//! A file in shared memory allocates its pages when they are first written, and where none is left the writer
//! gets SIGBUS in the midst of its work. So the space of a port is checked before iceoryx2 creates its files,
//! and their pages are allocated as soon as the files exist: from then on they cannot be taken by others.
//! Only one node at a time has the [`Turn`] in between: nodes of a bench open their ports at the same time,
//! and two that check before either allocates would both find enough space.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::Path;

use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::io::Errno;

use crate::OpenError;
use crate::shared_memory_config::{
    MAX_BORROWED, MAX_DEPTH, MAX_PUBLISHERS, MAX_SUBSCRIBERS, SHARED_MEMORY, prefix, root_path,
};

/// Memory that iceoryx2 needs per sample besides the sample: its header, its entry in the free list and its
/// reference count, bytes.
const BESIDE_A_SAMPLE: u64 = 96;
/// Memory of a segment besides its samples, bytes.
const BESIDE_SAMPLES: u64 = 64 << 10;
/// Memory of a connection between a publisher and a subscriber of the largest depth, bytes.
const CONNECTION: u64 = 32 << 10;
/// Memory of an iceoryx2 service, bytes.
const SERVICE: u64 = 16 << 10;
/// Margin that stays free for small files created later: connections to ports that open after this one,
/// bytes.
const MARGIN: u64 = 512 << 10;

/// Memory of a node's files and of a service that it opens, bytes.
pub(crate) const FOR_SERVICE: u64 = SERVICE;
/// Memory of the connections of one subscriber, bytes.
pub(crate) const FOR_SUBSCRIBER: u64 = MAX_PUBLISHERS as u64 * CONNECTION;

/// Memory of one publisher's segment and its connections, bytes; `sample` is the size of a message, bytes.
pub(crate) fn for_publisher(sample: usize) -> u64 {
    let samples = (MAX_SUBSCRIBERS * (MAX_DEPTH + MAX_BORROWED) + 1) as u64;
    samples * (sample as u64 + BESIDE_A_SAMPLE) + BESIDE_SAMPLES + MAX_SUBSCRIBERS as u64 * CONNECTION
}

/// Exclusive right of one node of a bench to reserve space, until it is dropped or its process ends.
pub(crate) struct Turn {
    bench: String,
    _folder: File,
}

impl Turn {
    /// Waits until no other node of the bench has its turn. The lock is on the bench's own folder, which
    /// exists before any port.
    ///
    /// # Errors
    /// [`OpenError::File`] when the folder cannot be opened or locked.
    pub(crate) fn wait(bench: &str) -> Result<Self, OpenError> {
        let path = root_path(bench);
        let locked = File::open(&path).and_then(|folder| folder.lock().map(|()| folder));
        let folder = locked.map_err(|source| OpenError::File { path, source })?;
        Ok(Self { bench: bench.into(), _folder: folder })
    }

    /// Checks that shared memory has space for `bytes` more.
    ///
    /// # Errors
    /// [`OpenError::Full`].
    pub(crate) fn require(&self, what: &str, bytes: u64) -> Result<(), OpenError> {
        let Ok(space) = statvfs(SHARED_MEMORY) else { return Ok(()) };
        // A file system without a limit reports no blocks.
        if space.f_blocks == 0 || space.f_bavail * space.f_frsize >= bytes + MARGIN {
            return Ok(());
        }
        Err(full(&self.bench, what, bytes + MARGIN))
    }

    /// Allocates the pages of the files of a port of the bench: those with the port's number in their name.
    ///
    /// # Errors
    /// [`OpenError::Full`] when there are not enough, [`OpenError::File`] for a file that cannot be used.
    pub(crate) fn reserve(&self, what: &str, port: u128) -> Result<(), OpenError> {
        let prefix = prefix(&self.bench);
        let number = format!("_{port}");
        let failed = |path: &Path, source| OpenError::File { path: path.into(), source };
        let folder = Path::new(SHARED_MEMORY);
        for entry in std::fs::read_dir(folder).map_err(|e| failed(folder, e))?.flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(&prefix) && name.contains(&number) {
                let path = entry.path();
                match take_pages(&path) {
                    // A connection's file is removed when the other side closes it.
                    Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                    Err(e) if e.kind() == io::ErrorKind::StorageFull => {
                        return Err(full(&self.bench, what, length(&path)));
                    }
                    other => other.map_err(|e| failed(&path, e))?,
                }
            }
        }
        Ok(())
    }
}

/// Allocates all pages of a file.
fn take_pages(path: &Path) -> io::Result<()> {
    let file = OpenOptions::new().read(true).write(true).open(path)?;
    take(&file, file.metadata()?.len())
}

/// Allocates the pages of the first `length` bytes of a file, and extends it to at least that length.
pub(crate) fn take(file: &std::fs::File, length: u64) -> io::Result<()> {
    if length == 0 {
        return Ok(());
    }
    match fallocate(file, FallocateFlags::empty(), 0, length) {
        Ok(()) => Ok(()),
        // This kind of file system allocates pages only when they are written.
        Err(Errno::OPNOTSUPP) if file.metadata()?.len() >= length => Ok(()),
        Err(Errno::OPNOTSUPP) => file.set_len(length),
        Err(e) => Err(e.into()),
    }
}

fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}

/// Error for too little space.
pub(crate) fn full(bench: &str, what: &str, needed: u64) -> OpenError {
    let space = statvfs(SHARED_MEMORY).ok();
    let bytes =
        |blocks: fn(&rustix::fs::StatVfs) -> u64| space.as_ref().map_or(0, |s| blocks(s) * s.f_frsize);
    OpenError::Full {
        what: what.into(),
        bench: bench.into(),
        needed,
        free: bytes(|s| s.f_bavail),
        total: bytes(|s| s.f_blocks),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two nodes that checked at once would both be promised the same free pages; the second would then get
    /// SIGBUS.
    #[test]
    fn one_node_of_a_bench_at_a_time_takes_room() {
        let bench = format!("turn-{}", std::process::id());
        let folder = root_path(&bench);
        std::fs::create_dir(&folder).unwrap();
        let other = File::open(&folder).unwrap();
        let turn = Turn::wait(&bench).unwrap();
        turn.require("a byte", 1).unwrap();
        assert!(matches!(other.try_lock(), Err(std::fs::TryLockError::WouldBlock)));
        drop(turn);
        other.try_lock().unwrap();
        std::fs::remove_dir(&folder).unwrap();
    }
}
