//! The messages of a DataFlash log one after the other, and the places where there are none.
//!
//! A message is two bytes of magic, its type, and content as long as the FMT message of that type says. There is no check
//! sum: a message counts only if its type was defined and another message, or the end of the file, follows where it ends.
//! Bytes that are no message are passed over one by one, and told.

use std::io::{self, Read};

use super::format::{DEFINITION, DEFINITION_LENGTH, Format, HEADER};

/// Bytes with which every message begins.
const MESSAGE: [u8; 2] = [0xa3, 0x95];

/// Bytes that are read at once.
const BLOCK: usize = 1 << 16;

/// A message.
#[derive(Debug, Clone, Copy)]
pub(super) struct Message<'a> {
    /// Its layout.
    pub format: &'a Format,
    /// What follows its header.
    pub content: &'a [u8],
    /// How often a layout has been defined or changed up to here.
    pub definitions: u64,
}

/// Bytes that are no messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Gaps {
    /// Stretches of them.
    pub places: u64,
    /// How many they are.
    pub bytes: u64,
    /// Where the first is.
    pub first: u64,
    /// Where a message begins whose end the file does not have.
    pub cut: Option<u64>,
}

/// The messages of a file.
pub(super) struct Messages<R> {
    file: R,
    /// What was read and not yet passed, from `next` on.
    buffer: Vec<u8>,
    next: usize,
    /// Place of `next` in the file.
    at: u64,
    /// Bytes of the message that was given out last.
    given: usize,
    formats: Vec<Option<Format>>,
    definitions: u64,
    gaps: Gaps,
    /// Where the stretch begins that is being passed over.
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

    /// The next message, whole.
    ///
    /// # Errors
    /// What the system says.
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

    /// What is no message, up to here.
    pub fn gaps(&self) -> Gaps {
        self.gaps
    }

    /// Layouts that were defined up to here.
    pub fn formats(&self) -> impl Iterator<Item = &Format> {
        self.formats.iter().flatten()
    }

    /// Whether a message of `length` bytes is whole, and followed by another or by nothing.
    fn is_message(&mut self, length: usize) -> io::Result<bool> {
        let bytes = self.peek(length + MESSAGE.len())?;
        let (had, fits) = (bytes.len(), bytes.get(length..).is_some_and(|next| MESSAGE.starts_with(next)));
        if had < length {
            self.gaps.cut.get_or_insert(self.at);
        }
        Ok(fits)
    }

    /// Takes note of the layout in a message that defines one. Returns whether it makes sense.
    fn defines(&mut self, kind: usize, length: usize) -> bool {
        if kind != usize::from(DEFINITION) {
            return true;
        }
        let format = Format::parse(&self.buffer[self.next + HEADER..self.next + length]);
        match format {
            Some(format) if format.kind != DEFINITION => {
                let known = &mut self.formats[usize::from(format.kind)];
                if known.as_ref() != Some(&format) {
                    *known = Some(format);
                    self.definitions += 1;
                }
                true
            }
            format => format.is_some(),
        }
    }

    /// Ends the stretch that is no message.
    fn close(&mut self) {
        if let Some(from) = self.open.take() {
            // What was taken for a message without its end was none if it is not the last of the file.
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

    /// The next bytes: as many as asked for, or all that there are.
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
