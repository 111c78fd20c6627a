//! Records written as CSV.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use super::CsvError;
use crate::record::Record;

/// Writes a record: `t[s]`, then every signal with its SI unit. Numbers are written so that they read back bit
/// for bit, and gaps as empty cells.
///
/// # Errors
/// [`CsvError::Io`].
pub fn write_csv(record: &Record, path: impl AsRef<Path>) -> Result<(), CsvError> {
    let path = path.as_ref();
    let write = || -> std::io::Result<()> {
        let mut out = BufWriter::with_capacity(1 << 16, File::create(path)?);
        format_csv(record, &mut out)?;
        out.flush()
    };
    write().map_err(|source| CsvError::Io { path: path.into(), source })
}

/// Writes a record as [`write_csv`] does, to any writer.
///
/// # Errors
/// The error of `out`.
pub fn format_csv(record: &Record, out: &mut impl Write) -> std::io::Result<()> {
    write!(out, "t[{}]", record.time_unit)?;
    for signal in record.signals() {
        let head = if signal.unit.is_empty() {
            signal.name.clone()
        } else {
            format!("{}[{}]", signal.name, signal.unit)
        };
        write!(out, ",{}", quoted(&head))?;
    }
    writeln!(out)?;
    for (i, t) in record.time.iter().enumerate() {
        write!(out, "{t}")?;
        for signal in record.signals() {
            let value = signal.values[i];
            if value.is_nan() { out.write_all(b",")? } else { write!(out, ",{value}")? }
        }
        writeln!(out)?;
    }
    Ok(())
}

/// A head quoted according to RFC 4180.
fn quoted(head: &str) -> String {
    if head.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", head.replace('"', "\"\""))
    } else {
        head.into()
    }
}
