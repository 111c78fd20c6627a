//! The file under a log writer: buffered, and closed to any write after a failed one.

use std::fs::File;
use std::io::{BufWriter, Result, Seek, SeekFrom, Write};

/// A file that accepts no more data once a write has failed. The data up to there stay readable, which they would
/// not with an index or a footer after half a chunk.
#[derive(Debug)]
pub(crate) struct Output {
    /// `None` after a failure.
    file: Option<BufWriter<File>>,
    position: u64,
}

impl Output {
    pub fn new(file: File) -> Self {
        Self { file: Some(BufWriter::new(file)), position: 0 }
    }

    /// Runs an operation on the file, as long as none has failed.
    fn attempt<T>(&mut self, what: impl FnOnce(&mut BufWriter<File>) -> Result<T>) -> Option<Result<T>> {
        let result = what(self.file.as_mut()?);
        if result.is_err()
            && let Some(file) = self.file.take()
        {
            // The buffer is discarded, so that it is not written again.
            drop(file.into_parts());
        }
        Some(result)
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let written = self.attempt(|file| file.write(bytes)).unwrap_or(Ok(bytes.len()))?;
        self.position += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> Result<()> {
        self.attempt(BufWriter::flush).unwrap_or(Ok(()))
    }
}

impl Seek for Output {
    /// The writer only asks for its position, and never moves it.
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.position),
            _ => Err(std::io::ErrorKind::Unsupported.into()),
        }
    }
}
