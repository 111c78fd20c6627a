//! Names of a bench's files, and the iceoryx2 configuration that joins it.

use std::path::PathBuf;

use iceoryx2::config::Config;
use iceoryx2::prelude::{FileName, Path, SemanticString};

use crate::OpenError;

/// Publishers a topic can have; every node publishes `health`.
pub const MAX_PUBLISHERS: usize = 8;

/// File name prefix of all that belongs to the bench. No bench name contains `~`, so no prefix begins another.
pub(crate) fn prefix(bench: &str) -> String {
    format!("whirlstand.{bench}~")
}

/// Folder of the bench's iceoryx2 files that are not shared memory.
pub(crate) fn root_path(bench: &str) -> PathBuf {
    format!("/tmp/whirlstand.{bench}").into()
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
