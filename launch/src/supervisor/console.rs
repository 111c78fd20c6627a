//! Console output of a node: the lines of its standard output and standard error, of which the last ones are
//! kept.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::time::{Duration, Instant};

/// Number of the last lines of a node that are kept.
const KEPT: usize = 20;

/// Longest line, bytes; a longer one is split.
const LONGEST: usize = 4096;

/// Time window over which a node's output is limited.
const WINDOW: Duration = Duration::from_secs(1);

/// Most bytes that are read from a pipe in one [`WINDOW`]. A node that writes more blocks on its pipe: reading an
/// endless stream in full would take a processor from the bench.
const MOST_BYTES: usize = 1 << 20;

/// Most lines of a node that are shown in one [`WINDOW`]; further ones are only counted.
const MOST_LINES: u64 = 200;

/// The reading end of a pipe into which a node writes lines.
#[derive(Debug)]
pub(crate) struct ConsoleReader {
    pipe: std::fs::File,
    partial: Vec<u8>,
    open: bool,
    window: Instant,
    /// Number of bytes read in this window.
    bytes: usize,
}

impl ConsoleReader {
    /// Reads from `pipe` without ever blocking.
    ///
    /// # Errors
    /// When the pipe cannot be made non-blocking.
    pub fn new(pipe: OwnedFd) -> std::io::Result<Self> {
        rustix::io::ioctl_fionbio(&pipe, true)?;
        Ok(Self { pipe: pipe.into(), partial: Vec::new(), open: true, window: Instant::now(), bytes: 0 })
    }

    /// Whether more may be read now.
    pub fn is_open(&self) -> bool {
        self.open && (self.bytes < MOST_BYTES || self.window.elapsed() >= WINDOW)
    }

    /// The lines that have arrived since the last call, within the limit; at the end of the pipe also a last line
    /// without a line end.
    pub fn drain(&mut self, now: Instant) -> Vec<String> {
        let mut buffer = [0; LONGEST];
        let mut lines = Vec::new();
        if now.duration_since(self.window) >= WINDOW {
            (self.window, self.bytes) = (now, 0);
        }
        while self.open && self.bytes < MOST_BYTES {
            match self.pipe.read(&mut buffer) {
                Ok(0) => self.open = false,
                Ok(n) => {
                    self.bytes += n;
                    self.split(&buffer[..n], &mut lines);
                }
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

/// Limits how many lines of a node are shown.
#[derive(Debug)]
pub(crate) struct LineQuota {
    window: Instant,
    shown: u64,
    left_out: u64,
}

impl LineQuota {
    pub fn new(now: Instant) -> Self {
        Self { window: now, shown: 0, left_out: 0 }
    }

    /// The lines that may be shown. The number of omitted lines is added at the end of the window, or when the
    /// node has `ended`.
    pub fn shown(&mut self, mut lines: Vec<String>, now: Instant, ended: bool) -> Vec<String> {
        let is_over = now.duration_since(self.window) >= WINDOW;
        let told = if is_over { self.take_left_out() } else { None };
        if is_over {
            (self.window, self.shown) = (now, 0);
        }
        let room = (MOST_LINES - self.shown) as usize;
        let beyond = lines.len().saturating_sub(room);
        lines.truncate(room);
        self.shown += lines.len() as u64;
        self.left_out += beyond as u64;
        let at_end = if ended { self.take_left_out() } else { None };
        told.into_iter().chain(lines).chain(at_end).collect()
    }

    fn take_left_out(&mut self) -> Option<String> {
        match std::mem::take(&mut self.left_out) {
            0 => None,
            n => Some(format!("({n} lines dropped: it writes more than {MOST_LINES} per second)")),
        }
    }
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
        let now = Instant::now();
        assert!(console.drain(now).is_empty() && console.is_open());
        writer.write_all(b"one\ntw").unwrap();
        assert_eq!(console.drain(now), ["one"]);
        writer.write_all(b"o\r\nthree").unwrap();
        assert_eq!(console.drain(now), ["two"]);
        drop(writer);
        assert_eq!(console.drain(now), ["three"]);
        assert!(!console.is_open());
    }

    #[test]
    fn an_endless_stream_is_read_in_part_and_shown_in_part() {
        let endless = std::fs::File::open("/dev/zero").unwrap();
        let mut console = ConsoleReader::new(endless.into()).unwrap();
        let now = Instant::now();
        assert_eq!(console.drain(now).len(), MOST_BYTES / LONGEST);
        assert!(console.drain(now).is_empty() && !console.is_open());
        assert_eq!(console.drain(now + WINDOW).len(), MOST_BYTES / LONGEST);

        let mut quota = LineQuota::new(now);
        let lines = vec![String::from("y"); 3 * MOST_LINES as usize];
        assert_eq!(quota.shown(lines.clone(), now, false).len() as u64, MOST_LINES);
        assert!(quota.shown(lines.clone(), now, false).is_empty());
        let next = quota.shown(lines, now + WINDOW, true);
        assert_eq!(next.len() as u64, MOST_LINES + 2);
        assert!(next[0].starts_with("(1000 lines dropped"), "{}", next[0]);
        assert!(next.last().unwrap().starts_with("(400 lines dropped"));
    }

    #[test]
    fn only_the_last_lines_are_kept() {
        let mut last = RecentLines::default();
        (0..KEPT + 5).for_each(|i| last.push(i.to_string()));
        assert_eq!(last.lines().len(), KEPT);
        assert_eq!(last.lines()[0], "5");
    }
}
