//! File names of a bench, and its iceoryx2 configuration.

use std::path::PathBuf;

use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, Path, SemanticString};

use crate::OpenError;

/// Folder of POSIX shared memory on Linux.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// Largest number of publishers per topic; every node publishes `health`.
pub const MAX_PUBLISHERS: usize = 8;
/// Largest number of subscribers per topic.
pub const MAX_SUBSCRIBERS: usize = 8;
/// Longest queue of a subscriber.
pub const MAX_DEPTH: usize = 1024;
/// Number of messages that a subscriber can hold besides its queue.
pub(crate) const MAX_BORROWED: usize = 2;

/// Parent folder of [`root_path`].
pub(crate) const ROOTS: &str = "/tmp";

/// Common prefix of the file names of all benches.
const FAMILY: &str = "whirlstand.";

/// File name prefix of the bench. No bench name contains `~`, so no prefix is the beginning of another.
pub(crate) fn prefix(bench: &str) -> String {
    format!("{FAMILY}{bench}~")
}

/// Bench of a file in shared memory, from the file's name.
pub(crate) fn bench_of_file(name: &str) -> Option<&str> {
    Some(name.strip_prefix(FAMILY)?.split_once('~')?.0)
}

/// Bench of a folder beside [`root_path`], from the folder's name.
pub(crate) fn bench_of_root(name: &str) -> Option<&str> {
    name.strip_prefix(FAMILY)
}

/// Folder of the bench's iceoryx2 files that are not shared memory.
pub(crate) fn root_path(bench: &str) -> PathBuf {
    PathBuf::from(ROOTS).join(format!("{FAMILY}{bench}"))
}

/// The iceoryx2 configuration of a bench.
pub(crate) fn config(bench: &str) -> Result<Config, OpenError> {
    let refused = |reason: String| OpenError::Name { what: "bench", name: bench.into(), reason };
    let mut config = Config::default();
    config.global.prefix =
        FileName::new(prefix(bench).as_bytes()).map_err(|e| refused(format!("iceoryx2: {e:?}")))?;
    let root = format!("{}/", root_path(bench).display());
    config
        .global
        .set_root_path(&Path::new(root.as_bytes()).map_err(|e| refused(format!("iceoryx2: {e:?}")))?);
    // Every poll for a message iterates over these places as well; iceoryx2's default of 128 costs more than
    // the rest of the poll. They hold messages of publishers that have ended; all publishers of a topic can
    // end at once.
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = MAX_PUBLISHERS;
    Ok(config)
}
