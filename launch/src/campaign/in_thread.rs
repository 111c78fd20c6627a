//! One bench in this thread, with a log that is looked at and thrown away: what it says is to the last bit what `run` logs.

use std::io;
use std::path::{Path, PathBuf};

use whirlstand_nodes::config::NodeConfig;
use whirlstand_nodes::error::NodeError;
use whirlstand_nodes::inproc::run_inproc;
use whirlstand_nodes::os::StopFlag;

/// A place for the log of one flight; it goes with this.
pub(super) struct InThread {
    folder: PathBuf,
    log: PathBuf,
}

impl InThread {
    /// A place under `scratch`, which no other flight of the same number uses at the same time.
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

    /// Flies a bench to its end. `bench` names it, differently from every other of this machine.
    ///
    /// # Errors
    /// As for each node; the log then holds what was flown.
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
        // What stays goes with the scratch folder.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
