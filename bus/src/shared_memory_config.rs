//! Names of a bench's files, and the iceoryx2 configuration that joins it.

use std::path::PathBuf;

use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, Path, SemanticString};

use crate::OpenError;

/// Where POSIX shared memory lives on Linux.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// Publishers a topic can have; every node publishes `health`.
pub const MAX_PUBLISHERS: usize = 8;
/// Subscribers a topic can have.
pub const MAX_SUBSCRIBERS: usize = 8;
/// Longest queue of a subscriber.
pub const MAX_DEPTH: usize = 1024;
/// Messages of a subscriber that it can hold beside its queue.
pub(crate) const MAX_BORROWED: usize = 2;

/// Where the folders of [`root_path`] are.
pub(crate) const ROOTS: &str = "/tmp";

/// How the names of all benches' files begin.
const FAMILY: &str = "whirlstand.";

/// File name prefix of all that belongs to the bench. No bench name contains `~`, so no prefix begins another.
pub(crate) fn prefix(bench: &str) -> String {
    format!("{FAMILY}{bench}~")
}

/// The bench that a file in shared memory belongs to by its name.
pub(crate) fn bench_of_file(name: &str) -> Option<&str> {
    Some(name.strip_prefix(FAMILY)?.split_once('~')?.0)
}

/// The bench that a folder beside [`root_path`] belongs to by its name.
pub(crate) fn bench_of_root(name: &str) -> Option<&str> {
    name.strip_prefix(FAMILY)
}

/// Folder of the bench's iceoryx2 files that are not shared memory.
pub(crate) fn root_path(bench: &str) -> PathBuf {
    PathBuf::from(ROOTS).join(format!("{FAMILY}{bench}"))
}

/// The iceoryx2 configuration that joins a bench.
pub(crate) fn config(bench: &str) -> Result<Config, OpenError> {
    let refused = |reason: String| OpenError::Name { what: "bench", name: bench.into(), reason };
    let mut config = Config::default();
    config.global.prefix =
        FileName::new(prefix(bench).as_bytes()).map_err(|e| refused(format!("iceoryx2: {e:?}")))?;
    let root = format!("{}/", root_path(bench).display());
    config
        .global
        .set_root_path(&Path::new(root.as_bytes()).map_err(|e| refused(format!("iceoryx2: {e:?}")))?);
    // Every look for a message walks over these places as well; iceoryx2's default of 128 costs more than all the rest
    // of the look. They hold what a publisher sent before it went, and as many publishers as a topic has can go at once.
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = MAX_PUBLISHERS;
    Ok(config)
}
