//! The files of a recorder: `log.mcap`, `log.2.mcap`, `log.3.mcap` and so on.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use whirlstand_logs::bench_info::{LAUNCH_ATTACHMENT, VEHICLE_ATTACHMENT};
use whirlstand_logs::{BenchInfo, LogWriter, SignalInfo};

use crate::config::{Mode, NodeConfig, RecorderConfig};
use crate::error::NodeError;
use crate::setup::Setup;

pub(super) struct LogFiles {
    base: PathBuf,
    paths: Vec<PathBuf>,
    most: usize,
    info: BenchInfo,
    launch_text: String,
    vehicle_text: String,
}

impl LogFiles {
    pub(super) fn new(config: &NodeConfig, recorder: &RecorderConfig, setup: &Setup) -> Self {
        let vehicle = &setup.vehicle;
        let signal =
            |name: &str, unit: &whirlstand_vehicle::SignalUnit| SignalInfo::new(name, unit.si_symbol());
        let info = BenchInfo {
            version: recorder.version.clone(),
            launch: config.bench.clone(),
            vehicle: vehicle.name.clone(),
            mode: match config.mode {
                Mode::Realtime => "realtime".into(),
                Mode::Lockstep => "lockstep".into(),
            },
            transport: config.transport.to_string(),
            seed: config.seed,
            period_ns: config.period_ns,
            started_unix_ns: 0,
            states: vehicle.states.iter().map(|s| signal(&s.name, &s.unit)).collect(),
            inputs: vehicle.inputs.iter().map(|s| signal(&s.name, &s.unit)).collect(),
            outputs: vehicle.outputs.iter().map(|s| signal(&s.name, &s.unit)).collect(),
            ..BenchInfo::default()
        };
        Self {
            base: PathBuf::from(&recorder.path),
            paths: Vec::new(),
            most: recorder.most_files as usize,
            info,
            launch_text: recorder.launch_text.clone(),
            vehicle_text: config.vehicle.text.clone(),
        }
    }

    /// Creates the next file; never touches one that exists.
    pub(super) fn next(&mut self) -> Result<LogWriter, NodeError> {
        let path = free_path(&self.base);
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.info.started_unix_ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        let mut log = LogWriter::create(&path, &self.info)?;
        log.attach(LAUNCH_ATTACHMENT, "application/toml", self.launch_text.as_bytes())?;
        log.attach(VEHICLE_ATTACHMENT, "application/toml", self.vehicle_text.as_bytes())?;
        self.paths.push(path);
        Ok(log)
    }

    /// Whether no further file may be begun: the plant cannot have been started more often.
    pub(super) fn are_all(&self) -> bool {
        self.paths.len() >= self.most
    }

    pub(super) fn current(&self) -> &Path {
        self.paths.last().unwrap_or(&self.base)
    }

    pub(super) fn paths(&self) -> &[PathBuf] {
        &self.paths
    }
}

/// `base`, or when it exists the first of `stem.2.ext`, `stem.3.ext`, ... that does not.
fn free_path(base: &Path) -> PathBuf {
    let stem = base.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let extension = base.extension().unwrap_or_default().to_string_lossy().into_owned();
    let numbered = (2u32..).map(|n| base.with_file_name(format!("{stem}.{n}.{extension}")));
    std::iter::once(base.to_path_buf())
        .chain(numbered)
        .find(|path| !path.exists())
        .unwrap_or_else(|| base.to_path_buf())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_log_is_ever_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("log.mcap");
        for name in ["log.mcap", "log.2.mcap", "log.3.mcap"] {
            let path = free_path(&base);
            assert_eq!(path.file_name().unwrap(), name);
            std::fs::write(path, b"x").unwrap();
        }
    }
}
