//! Room in shared memory, seen to before it is used.
//!
//! A file in shared memory takes its pages when they are first written, and where none is left the writer gets SIGBUS in
//! the midst of its work. So what a port will need is asked for before iceoryx2 makes its files, and their pages are taken
//! as soon as the files are there: from then on nobody else can have them. Between the two it is one node's [`Turn`]: the
//! nodes of a bench open their ports at the same time, and two that ask before either takes would both be told that there
//! is room.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::Path;

use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::io::Errno;

use crate::OpenError;
use crate::shared_memory_config::{
    MAX_BORROWED, MAX_DEPTH, MAX_PUBLISHERS, MAX_SUBSCRIBERS, SHARED_MEMORY, prefix, root_path,
};

/// What iceoryx2 keeps beside each sample: its header, its place in the free list and its reference count, bytes.
const BESIDE_A_SAMPLE: u64 = 96;
/// What a segment has beside its samples, bytes.
const BESIDE_SAMPLES: u64 = 64 << 10;
/// A connection between a publisher and a subscriber of the greatest depth, bytes.
const CONNECTION: u64 = 32 << 10;
/// What iceoryx2 keeps of a service, bytes.
const SERVICE: u64 = 16 << 10;
/// What stays free, for the small files that come later: connections to ports that open after this one, bytes.
const MARGIN: u64 = 512 << 10;

/// Files of a node and of a service that opens it.
pub(crate) const FOR_SERVICE: u64 = SERVICE;
/// Connections of one subscriber.
pub(crate) const FOR_SUBSCRIBER: u64 = MAX_PUBLISHERS as u64 * CONNECTION;

/// The segment of one publisher and its connections; `sample` is the size of a message, bytes.
pub(crate) fn for_publisher(sample: usize) -> u64 {
    let samples = (MAX_SUBSCRIBERS * (MAX_DEPTH + MAX_BORROWED) + 1) as u64;
    samples * (sample as u64 + BESIDE_A_SAMPLE) + BESIDE_SAMPLES + MAX_SUBSCRIBERS as u64 * CONNECTION
}

/// The time in which one node of a bench, and no other, takes room: until it is dropped, or its process ends.
pub(crate) struct Turn {
    bench: String,
    _folder: File,
}

impl Turn {
    /// Waits until no other node of the bench has its turn. What is locked is the bench's own folder, which is there before
    /// any port is.
    ///
    /// # Errors
    /// [`OpenError::File`] when the folder cannot be opened or locked.
    pub(crate) fn wait(bench: &str) -> Result<Self, OpenError> {
        let path = root_path(bench);
        let locked = File::open(&path).and_then(|folder| folder.lock().map(|()| folder));
        let folder = locked.map_err(|source| OpenError::File { path, source })?;
        Ok(Self { bench: bench.into(), _folder: folder })
    }

    /// Sees that shared memory has room for `bytes` more.
    ///
    /// # Errors
    /// [`OpenError::Full`].
    pub(crate) fn require(&self, what: &str, bytes: u64) -> Result<(), OpenError> {
        let Ok(space) = statvfs(SHARED_MEMORY) else { return Ok(()) };
        // A file system without a limit says that it has no blocks.
        if space.f_blocks == 0 || space.f_bavail * space.f_frsize >= bytes + MARGIN {
            return Ok(());
        }
        Err(full(&self.bench, what, bytes + MARGIN))
    }

    /// Takes the pages of the files that belong to a port of the bench: those with its number in their name.
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
                    // A connection goes when the other side does.
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

/// Takes the pages of a file as long as it is.
fn take_pages(path: &Path) -> io::Result<()> {
    let file = OpenOptions::new().read(true).write(true).open(path)?;
    take(&file, file.metadata()?.len())
}

/// Takes the pages of the first `length` bytes of a file, and makes it that long at least.
pub(crate) fn take(file: &std::fs::File, length: u64) -> io::Result<()> {
    if length == 0 {
        return Ok(());
    }
    match fallocate(file, FallocateFlags::empty(), 0, length) {
        Ok(()) => Ok(()),
        // This kind of file system takes pages when they are written, and there is no other way.
        Err(Errno::OPNOTSUPP) if file.metadata()?.len() >= length => Ok(()),
        Err(Errno::OPNOTSUPP) => file.set_len(length),
        Err(e) => Err(e.into()),
    }
}

fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}

/// The error that tells of too little room.
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

    /// Two nodes that asked at once were both told of the same free pages; the second was then ended by SIGBUS.
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
