//! Files of a recorder: `log.mcap`, `log.2.mcap`, `log.3.mcap` and so on, and their largest size.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use whirlstand_logs::bench_info::{LAUNCH_ATTACHMENT, VEHICLE_ATTACHMENT};
use whirlstand_logs::{BenchInfo, LogWriter, Segments, SignalInfo, WriteError};

use crate::config::{Mode, NodeConfig, RecorderConfig};
use crate::setup::Setup;

/// Least number of chunks of a file with limited size.
const FEWEST_CHUNKS: u64 = 8;

/// Limits of a file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Largest size, bytes.
    pub(super) bytes: Option<u64>,
    /// Longest duration in bench time, ns.
    pub(super) duration_ns: Option<u64>,
    /// Number of files kept.
    files: Option<usize>,
}

pub(super) struct LogFiles {
    /// Existing files, including those of an earlier recorder of this run.
    segments: Segments,
    /// Files that this recorder wrote and has not removed.
    paths: Vec<PathBuf>,
    current: PathBuf,
    limits: Limits,
    info: BenchInfo,
    launch_text: String,
    vehicle_text: String,
}

impl LogFiles {
    pub(super) fn new(config: &NodeConfig, recorder: &RecorderConfig, setup: &Setup) -> Self {
        let vehicle = &setup.vehicle;
        let signal = |name: &str, unit: &whirlstand_vehicle::SignalUnit| SignalInfo::of(name, &unit.shown());
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
            segments: Segments::of(Path::new(&recorder.path)),
            paths: Vec::new(),
            current: PathBuf::from(&recorder.path),
            limits: Limits {
                bytes: recorder.max_bytes,
                duration_ns: recorder.max_duration_ns,
                files: recorder.segments.map(|n| n as usize),
            },
            info,
            launch_text: recorder.launch_text.clone(),
            vehicle_text: config.vehicle.text.clone(),
        }
    }

    /// Description of the bench in the files.
    pub(super) fn info(&self) -> &BenchInfo {
        &self.info
    }

    /// Limits of a file.
    pub(super) fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Creates the next file; never overwrites an existing one, but removes the oldest when there are more
    /// than the number to keep.
    pub(super) fn next(&mut self) -> Result<LogWriter, WriteError> {
        self.current = self.segments.next();
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        self.info.started_unix_ns = u64::try_from(now.as_nanos()).unwrap_or(u64::MAX);
        let log = self.begin().inspect_err(|_| self.remove(&self.current))?;
        self.segments.add(&self.current);
        self.paths.push(self.current.clone());
        while let Some(oldest) = self.limits.files.and_then(|most| self.segments.pop_oldest_beyond(most)) {
            self.remove(&oldest);
            self.paths.retain(|path| *path != oldest);
        }
        Ok(log)
    }

    fn begin(&self) -> Result<LogWriter, WriteError> {
        let most = self.limits.bytes.map_or(u64::MAX, |bytes| bytes / FEWEST_CHUNKS);
        let mut log = LogWriter::create_in_chunks(&self.current, &self.info, most)?;
        log.attach(LAUNCH_ATTACHMENT, "application/toml", self.launch_text.as_bytes())?;
        log.attach(VEHICLE_ATTACHMENT, "application/toml", self.vehicle_text.as_bytes())?;
        Ok(log)
    }

    /// Removes the file that was created last.
    pub(super) fn discard(&mut self) {
        self.remove(&self.current);
        self.paths.retain(|path| *path != self.current);
        self.segments.remove(&self.current);
    }

    fn remove(&self, path: &Path) {
        if let Err(error) = std::fs::remove_file(path)
            && error.kind() != std::io::ErrorKind::NotFound
        {
            tracing::warn!("cannot remove {}: {error}", path.display());
        }
    }

    /// True when no recorder has recorded anything of this run before.
    pub(super) fn is_new(&self) -> bool {
        self.segments.files().all(|file| self.paths.iter().any(|own| own == file))
    }

    pub(super) fn current(&self) -> &Path {
        &self.current
    }

    pub(super) fn paths(&self) -> &[PathBuf] {
        &self.paths
    }
}
