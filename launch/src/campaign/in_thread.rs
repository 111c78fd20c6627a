//! One bench in this thread, with a log that is evaluated and then deleted. The log's contents are bit for bit
//! what `run` logs.

use std::io;
use std::path::{Path, PathBuf};

use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::error::NodeError;
use whirlstand_nodes::inproc::run_inproc;
use whirlstand_nodes::os::StopFlag;

/// A folder for the log of one flight; it is removed when this value is dropped.
pub(super) struct InThread {
    folder: PathBuf,
    log: PathBuf,
}

impl InThread {
    /// Makes a folder under `scratch` that no other flight of the same number uses at the same time.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn new(scratch: &Path, number: u64) -> io::Result<Self> {
        let folder = scratch.join(number.to_string());
        std::fs::create_dir(&folder)?;
        Ok(Self { log: folder.join("log.mcap"), folder })
    }

    /// The log of the flight.
    pub fn log(&self) -> &Path {
        &self.log
    }

    /// Flies a bench to its end. `bench` is its name, which must differ from the name of every other bench on
    /// this machine.
    ///
    /// # Errors
    /// As for each node; the log then holds the steps that were flown.
    pub fn fly(&self, mut config: NodeConfig, bench: String) -> Result<(), NodeError> {
        config.bench = bench;
        if let Some(recorder) = &mut config.recorder {
            recorder.path = self.log.to_string_lossy().into_owned();
        }
        run_inproc(&config, &StopFlag::default()).map(drop)
    }
}

impl Drop for InThread {
    fn drop(&mut self) {
        // A folder that cannot be removed is removed with the scratch folder.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
