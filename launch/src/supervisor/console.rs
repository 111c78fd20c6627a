//! Console messages of a node: the lines of its standard output and standard error, the last of which are kept.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

/// How many of the last lines of a node are kept.
const KEPT: usize = 20;

/// Longest line; what is longer is cut into several.
const LONGEST: usize = 4096;

/// The reading end of a pipe into which a node writes lines.
#[derive(Debug)]
pub(crate) struct ConsoleReader {
    pipe: std::fs::File,
    partial: Vec<u8>,
    open: bool,
}

impl ConsoleReader {
    /// Reads from `pipe` without ever blocking.
    ///
    /// # Errors
    /// When the pipe cannot be made non-blocking.
    pub fn new(pipe: OwnedFd) -> std::io::Result<Self> {
        rustix::io::ioctl_fionbio(&pipe, true)?;
        Ok(Self { pipe: pipe.into(), partial: Vec::new(), open: true })
    }

    /// Whether more can come.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// The lines that have come since the last call; at the end of the pipe also one without a line end.
    pub fn drain(&mut self) -> Vec<String> {
        let mut buffer = [0; LONGEST];
        let mut lines = Vec::new();
        while self.open {
            match self.pipe.read(&mut buffer) {
                Ok(0) => self.open = false,
                Ok(n) => self.split(&buffer[..n], &mut lines),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(_) => self.open = false,
            }
        }
        if !self.open && !self.partial.is_empty() {
            lines.push(text(&std::mem::take(&mut self.partial)));
        }
        lines
    }

    fn split(&mut self, bytes: &[u8], lines: &mut Vec<String>) {
        for &byte in bytes {
            if byte != b'\n' {
                self.partial.push(byte);
            }
            if byte == b'\n' || self.partial.len() >= LONGEST {
                lines.push(text(&std::mem::take(&mut self.partial)));
            }
        }
    }
}

impl AsFd for ConsoleReader {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pipe.as_fd()
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim_end().to_string()
}

/// The last lines that a node wrote.
#[derive(Debug, Clone, Default)]
pub(crate) struct RecentLines(VecDeque<String>);

impl RecentLines {
    /// Adds a line and forgets the oldest when there are too many.
    pub fn push(&mut self, line: String) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(line);
    }

    /// The lines, oldest first.
    pub fn lines(&self) -> Vec<String> {
        self.0.iter().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn lines_come_whole_and_the_last_one_without_its_end() {
        let (reader, mut writer) = std::io::pipe().unwrap();
        let mut console = ConsoleReader::new(reader.into()).unwrap();
        assert!(console.drain().is_empty() && console.is_open());
        writer.write_all(b"one\ntw").unwrap();
        assert_eq!(console.drain(), ["one"]);
        writer.write_all(b"o\r\nthree").unwrap();
        assert_eq!(console.drain(), ["two"]);
        drop(writer);
        assert_eq!(console.drain(), ["three"]);
        assert!(!console.is_open());
    }

    #[test]
    fn only_the_last_lines_are_kept() {
        let mut last = RecentLines::default();
        (0..KEPT + 5).for_each(|i| last.push(i.to_string()));
        assert_eq!(last.lines().len(), KEPT);
        assert_eq!(last.lines()[0], "5");
    }
}
