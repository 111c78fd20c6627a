//! A log of any known kind as a [`Record`].

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::bench_record::{BenchRecordError, bench_record, bench_record_of};
use crate::blackbox::{self, BlackboxError, read_blackbox};
use crate::csv_file::{CsvError, read_csv, write_csv};
use crate::dataflash::{self, DataflashError, read_dataflash};
use crate::foreign::{ForeignError, read_foreign};
use crate::log::Log;
use crate::mapping::{MapError, Mapping, MissingSource};
use crate::multi::MultiError;
use crate::read_error::ReadError;
use crate::record::{Record, SignalError};
use crate::segments::Segments;
use crate::ulog::{UlogError, read_ulog};

/// The reason why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum AnyReadError {
    /// The file cannot be opened.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// An error of a CSV file.
    #[error(transparent)]
    Csv(#[from] CsvError),
    /// An error of an MCAP file.
    #[error(transparent)]
    Mcap(#[from] ReadError),
    /// An error of a bench's log.
    #[error(transparent)]
    Bench(#[from] BenchRecordError),
    /// An error of an MCAP log of another program.
    #[error(transparent)]
    Foreign(#[from] ForeignError),
    /// An error of a ULog.
    #[error(transparent)]
    Ulog(#[from] UlogError),
    /// An error of a DataFlash log.
    #[error(transparent)]
    Dataflash(#[from] DataflashError),
    /// An error of a blackbox log.
    #[error(transparent)]
    Blackbox(#[from] BlackboxError),
    /// A mapping does not fit.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A requested signal is not in the log.
    #[error(transparent)]
    Missing(#[from] SignalError),
}

impl AnyReadError {
    /// The source of a mapping that the log does not have, if that is the error.
    pub fn missing_source(&self) -> Option<&MissingSource> {
        let map = match self {
            Self::Csv(CsvError::Map(error)) | Self::Map(error) => error,
            Self::Foreign(ForeignError::Multi(MultiError::Map { error, .. }))
            | Self::Ulog(UlogError::Multi(MultiError::Map { error, .. }))
            | Self::Dataflash(DataflashError::Multi(MultiError::Map { error, .. }))
            | Self::Blackbox(BlackboxError::Multi(MultiError::Map { error, .. })) => error,
            _ => return None,
        };
        match map {
            MapError::Missing(missing) => Some(missing),
            _ => None,
        }
    }
}

/// Beginning of the text that Git LFS leaves in the place of a file that it has not fetched.
const LFS_POINTER: &[u8] = b"version https://git-lfs.";

/// The kinds of log, recognised by the beginning of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// MCAP, or a folder with a `log.mcap` in it.
    Mcap,
    /// PX4 ULog.
    Ulog,
    /// ArduPilot DataFlash.
    Dataflash,
    /// Blackbox of Betaflight, INAV or Cleanflight.
    Blackbox,
    /// Any other file.
    Csv,
}

/// The kind of a log, from its first bytes, whatever its name. The extension (`.bin`, `.bbl`, `.bfl`) decides only
/// where the first bytes are not conclusive, as in a file with a damaged beginning.
///
/// # Errors
/// The error of the operating system, or that the file is empty or a pointer to the log.
pub fn kind(path: &Path) -> std::io::Result<Kind> {
    // The first file of a log may have been removed by its recorder.
    if path.is_dir() || !path.exists() && Segments::of(path).files().next().is_some() {
        return Ok(Kind::Mcap);
    }
    let mut start = Vec::new();
    File::open(path)?.take(32).read_to_end(&mut start)?;
    if start.starts_with(LFS_POINTER) {
        return Err(std::io::Error::other(
            "this is a pointer of Git LFS to the log, not the log; `git lfs pull` fetches it",
        ));
    }
    let ending = |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    if start.is_empty() && !ending("mcap") {
        return Err(std::io::Error::other("the file is empty; copy the log again"));
    }
    Ok(if start.starts_with(&mcap::MAGIC[..5]) {
        Kind::Mcap
    } else if start.starts_with(b"ULog\x01\x12\x35") {
        Kind::Ulog
    } else if start.starts_with(&dataflash::MAGIC) {
        Kind::Dataflash
    } else if start.starts_with(blackbox::MAGIC) {
        Kind::Blackbox
    } else if start.is_empty() && ending("mcap") {
        // An empty file of a recorder that was killed before its first write.
        Kind::Mcap
    } else if ending("bin") {
        Kind::Dataflash
    } else if ending("bbl") || ending("bfl") {
        Kind::Blackbox
    } else {
        Kind::Csv
    })
}

/// Reads a log of any known kind into SI units.
///
/// In CSV and in logs of this program, mapped signals get their new names and the others keep theirs. ULog,
/// DataFlash, blackbox and MCAP logs of other programs have signals on many clocks: the mapped ones are read and
/// resampled to the clock of the fastest. Inputs (`u_...`) are held from sample to sample, other signals are
/// interpolated.
///
/// # Errors
/// [`AnyReadError`].
pub fn read(path: impl AsRef<Path>, mappings: &[Mapping]) -> Result<Record, AnyReadError> {
    let path = path.as_ref();
    let kind = kind(path).map_err(|source| AnyReadError::Io { path: path.into(), source })?;
    match kind {
        Kind::Csv => Ok(read_csv(path, mappings)?),
        Kind::Ulog => Ok(read_ulog(path, mappings)?),
        Kind::Dataflash => Ok(read_dataflash(path, mappings)?),
        Kind::Blackbox => Ok(read_blackbox(path, mappings)?),
        Kind::Mcap => {
            let log = Log::open(path)?;
            match log.info() {
                Some(_) => Ok(bench_record(&log)?.mapped(mappings)?),
                None => Ok(read_foreign(path, mappings)?),
            }
        }
    }
}

/// As [`read`], but only these signals of a log of this program, if it has all of them and no mapping is given.
/// The other signals take no memory.
///
/// # Errors
/// [`AnyReadError`].
pub fn read_signals(
    path: impl AsRef<Path>,
    mappings: &[Mapping],
    signals: &[&str],
) -> Result<Record, AnyReadError> {
    let path = path.as_ref();
    let of_bench = mappings.is_empty() && kind(path).is_ok_and(|kind| kind == Kind::Mcap);
    if of_bench
        && let Ok(log) = Log::open(path)
        && log.info().is_some()
    {
        let record = bench_record_of(&log, &|name| signals.contains(&name))?;
        if record.signals().len() == signals.len() {
            return Ok(record);
        }
    }
    // The error for a missing signal lists the names of all signals.
    read(path, mappings)
}

/// Writes a log of any known kind as one wide CSV, with the `signals` only, or with all signals if the list
/// is empty.
///
/// # Errors
/// [`AnyReadError`].
pub fn export(
    log: impl AsRef<Path>,
    mappings: &[Mapping],
    signals: &[String],
    csv: impl AsRef<Path>,
) -> Result<Exported, AnyReadError> {
    let mut record = read(log, mappings)?;
    if !signals.is_empty() {
        record = record.only(signals)?;
    }
    write_csv(&record, csv)?;
    Ok(Exported { rows: record.len(), signals: record.names(), duration: record.duration() })
}

/// Summary of the file that [`export`] wrote.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Exported {
    /// Lines below the head.
    pub rows: usize,
    /// Columns beside the time.
    pub signals: Vec<String>,
    /// Time from the first line to the last, s.
    pub duration: f64,
}
