//! A log of any known kind as a [`Record`].

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::bench_record::{BenchRecordError, bench_record};
use crate::csv_file::{CsvError, read_csv};
use crate::log::Log;
use crate::mapping::{MapError, Mapping};
use crate::record::Record;
use crate::stream::ReadError;

/// Why a log cannot be read.
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
    /// As CSV.
    #[error(transparent)]
    Csv(#[from] CsvError),
    /// As MCAP.
    #[error(transparent)]
    Mcap(#[from] ReadError),
    /// As a log of a bench.
    #[error(transparent)]
    Bench(#[from] BenchRecordError),
    /// A mapping does not fit.
    #[error(transparent)]
    Map(#[from] MapError),
}

/// The kinds of log, told by how the file begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// MCAP, or a folder with a `log.mcap` in it.
    Mcap,
    /// PX4 ULog.
    Ulog,
    /// Anything else.
    Csv,
}

/// Tells the kind of a log from its first bytes, whatever the file is called.
///
/// # Errors
/// What the system says.
pub fn kind(path: &Path) -> std::io::Result<Kind> {
    if path.is_dir() {
        return Ok(Kind::Mcap);
    }
    let mut start = Vec::new();
    File::open(path)?.take(8).read_to_end(&mut start)?;
    Ok(if start.starts_with(&mcap::MAGIC[..5]) {
        Kind::Mcap
    } else if start.starts_with(b"ULog\x01\x12\x35") {
        Kind::Ulog
    } else if start.is_empty() && path.extension().is_some_and(|e| e == "mcap") {
        // A recorder that was killed before its first write.
        Kind::Mcap
    } else {
        Kind::Csv
    })
}

/// Reads a log of any known kind into SI units. Mapped signals get their new names; the others keep theirs.
///
/// # Errors
/// [`AnyReadError`].
pub fn read(path: impl AsRef<Path>, mappings: &[Mapping]) -> Result<Record, AnyReadError> {
    let path = path.as_ref();
    let kind = kind(path).map_err(|source| AnyReadError::Io { path: path.into(), source })?;
    match kind {
        Kind::Csv | Kind::Ulog => Ok(read_csv(path, mappings)?),
        Kind::Mcap => Ok(bench_record(&Log::open(path)?)?.mapped(mappings)?),
    }
}
