//! The sequence of messages in a DataFlash log, and the byte ranges that contain none.
//!
//! A message is two bytes of magic, its type, and content of the length that the FMT message of that type defines.
//! There is no checksum. A message counts only if its type was defined and another message, or the end of the
//! file, follows its end. Bytes that belong to no message are skipped one by one, and reported.

use std::io::{self, Read};

use super::format::{DEFINITION, DEFINITION_LENGTH, Format, HEADER};

/// Bytes with which every message begins.
const MESSAGE: [u8; 2] = [0xa3, 0x95];

/// Bytes that are read at a time.
const BLOCK: usize = 1 << 16;

/// A message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Message<'a> {
    /// Layout of the message.
    pub format: &'a Format,
    /// Bytes after the header.
    pub content: &'a [u8],
    /// Number of definitions and changes of layouts up to here.
    pub definitions: u64,
}

/// Byte ranges that contain no message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Gaps {
    /// Number of ranges.
    pub places: u64,
    /// Number of bytes in the ranges.
    pub bytes: u64,
    /// Offset of the first range.
    pub first: u64,
    /// Offset of a last message that the end of the file cuts off.
    pub cut: Option<u64>,
}

/// The messages of a file.
pub(super) struct Messages<R> {
    file: R,
    /// Bytes that were read; those from `next` on have not been consumed.
    buffer: Vec<u8>,
    next: usize,
    /// Offset of `next` in the file.
    at: u64,
    /// Length of the message that was returned last, bytes.
    given: usize,
    formats: Vec<Option<Format>>,
    definitions: u64,
    gaps: Gaps,
    /// Start of the range that is being skipped.
    open: Option<u64>,
}

impl<R: Read> Messages<R> {
    pub fn new(file: R) -> Self {
        let mut formats = vec![None; 256];
        formats[usize::from(DEFINITION)] = Some(Format {
            kind: DEFINITION,
            length: DEFINITION_LENGTH,
            name: "FMT".into(),
            fields: Vec::new(),
            unknown: None,
        });
        let (buffer, gaps) = (Vec::with_capacity(2 * BLOCK), Gaps::default());
        Self { file, buffer, next: 0, at: 0, given: 0, formats, definitions: 0, gaps, open: None }
    }

    /// The next complete message.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn next(&mut self) -> io::Result<Option<Message<'_>>> {
        self.pass(self.given);
        self.given = 0;
        loop {
            let header = self.peek(HEADER)?;
            let kind = match *header {
                [] => {
                    self.close();
                    return Ok(None);
                }
                [a, b, kind] if [a, b] == MESSAGE => Some(usize::from(kind)),
                [0xa3] | [0xa3, 0x95] => {
                    self.gaps.cut.get_or_insert(self.at);
                    None
                }
                _ => None,
            };
            let length = kind.and_then(|kind| self.formats[kind].as_ref()).map(|format| format.length.into());
            if let (Some(kind), Some(length)) = (kind, length)
                && self.is_message(length)?
                && self.defines(kind, length)
            {
                self.close();
                self.given = length;
                let content = &self.buffer[self.next + HEADER..self.next + length];
                let definitions = self.definitions;
                return Ok(self.formats[kind].as_ref().map(|format| Message {
                    format,
                    content,
                    definitions,
                }));
            }
            self.open.get_or_insert(self.at);
            self.pass(1);
        }
    }

    /// Ranges without messages up to here.
    pub fn gaps(&self) -> Gaps {
        self.gaps
    }

    /// Layouts defined up to here.
    pub fn formats(&self) -> impl Iterator<Item = &Format> {
        self.formats.iter().flatten()
    }

    /// Whether a message of `length` bytes is complete, and followed by another one or by the end of the
    /// file.
    fn is_message(&mut self, length: usize) -> io::Result<bool> {
        let bytes = self.peek(length + MESSAGE.len())?;
        let (had, fits) = (bytes.len(), bytes.get(length..).is_some_and(|next| MESSAGE.starts_with(next)));
        if had < length {
            self.gaps.cut.get_or_insert(self.at);
        }
        Ok(fits)
    }

    /// Stores the layout in a message that defines one. Returns whether it is consistent.
    fn defines(&mut self, kind: usize, length: usize) -> bool {
        if kind != usize::from(DEFINITION) {
            return true;
        }
        let content = &self.buffer[self.next + HEADER..self.next + length];
        if content.starts_with(&[DEFINITION]) {
            // The layout of these messages is that of the format. Old autopilots name one field too few in it.
            return content[1] == DEFINITION_LENGTH;
        }
        let Some(format) = Format::parse(content) else { return false };
        let known = &mut self.formats[usize::from(format.kind)];
        if known.as_ref() != Some(&format) {
            *known = Some(format);
            self.definitions += 1;
        }
        true
    }

    /// Ends the range without messages.
    fn close(&mut self) {
        if let Some(from) = self.open.take() {
            // A message without its end was none, unless it is the last of the file.
            let cut = self.gaps.cut.take().filter(|cut| *cut == from && self.next == self.buffer.len());
            if cut.is_some() {
                self.gaps.cut = cut;
                return;
            }
            if self.gaps.places == 0 {
                self.gaps.first = from;
            }
            self.gaps.places += 1;
            self.gaps.bytes += self.at - from;
        }
    }

    /// The next bytes: as many as `wanted`, or all that remain.
    fn peek(&mut self, wanted: usize) -> io::Result<&[u8]> {
        if self.buffer.len() - self.next < wanted {
            self.buffer.drain(..self.next);
            self.next = 0;
            self.file.by_ref().take(BLOCK as u64).read_to_end(&mut self.buffer)?;
        }
        let end = self.buffer.len().min(self.next + wanted);
        Ok(&self.buffer[self.next..end])
    }

    fn pass(&mut self, bytes: usize) {
        self.next += bytes;
        self.at += bytes as u64;
    }
}
