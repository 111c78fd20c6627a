//! Passes the messages of a ULog file to the parser one at a time, each complete and with its inner lengths
//! checked.
//!
//! The parser trusts the lengths inside two kinds of message, and panics where they are wrong. Here they are first
//! compared with the size of the message. The layout is that of the PX4 user guide, "ULog File Format".

use std::io::{self, Read, Seek, SeekFrom};

use px4_ulog::stream_parser::LogParser;
use px4_ulog::stream_parser::model::{Completeness, UlogParseError};

/// Bytes of the file header: magic, version and start time.
const FILE_HEADER: usize = 16;

/// Bytes of a message header: a little-endian 16-bit length of the content, and a letter for the kind.
const MESSAGE_HEADER: usize = 3;

/// The reason why the messages of a file cannot be read to its end.
#[derive(Debug, thiserror::Error)]
pub(super) enum FramingError {
    /// The file cannot be read.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The file header or the definitions are not those of a ULog.
    #[error("not a readable ULog: {0}")]
    Definitions(UlogParseError),
    /// The content of a message is shorter than a length inside it states.
    #[error("the length in the message at byte {0} points past its end: the file is damaged")]
    Length(u64),
}

/// Passes the first section of a file, and the sections appended to it after a crash, to the parser.
///
/// # Errors
/// [`FramingError`]. A damaged message after the definitions is no error: the data read before it are valid.
pub(super) fn read_sections(
    file: &mut (impl Read + Seek),
    parser: &mut LogParser<'_>,
) -> Result<Completeness, FramingError> {
    match read_all(file, parser) {
        Ok(true) => Ok(Completeness::Complete),
        Ok(false) => Ok(Completeness::Truncated),
        Err(Stop::Parser(error)) if parser.in_data() => Ok(Completeness::MalformedRecord(error.to_string())),
        Err(Stop::Parser(error)) => Err(FramingError::Definitions(error)),
        Err(Stop::Framing(error)) => Err(error),
    }
}

/// Reason for the end of reading before the end of the file.
enum Stop {
    Parser(UlogParseError),
    Framing(FramingError),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        Self::Framing(error.into())
    }
}

/// Reads all sections. Returns whether the last section ends with a complete message.
fn read_all(file: &mut (impl Read + Seek), parser: &mut LogParser<'_>) -> Result<bool, Stop> {
    let appended = |parser: &LogParser<'_>| parser.appended_offsets().map(|at| (at != 0).then_some(at));
    // One of the first section's own messages states where it ends.
    let mut whole = read_section(file, 0, &|parser| appended(parser).into_iter().flatten().next(), parser)?;
    let starts: Vec<u64> = appended(parser).into_iter().flatten().collect();
    for (n, start) in starts.iter().enumerate() {
        file.seek(SeekFrom::Start(*start))?;
        let end = starts.get(n + 1).copied();
        whole = read_section(file, *start, &|_| end, parser)?;
    }
    Ok(whole)
}

/// Reads the messages from byte `at` on. Returns whether the section ends with a complete message.
fn read_section(
    file: &mut impl Read,
    mut at: u64,
    end: &dyn Fn(&LogParser<'_>) -> Option<u64>,
    parser: &mut LogParser<'_>,
) -> Result<bool, Stop> {
    let mut message = Vec::new();
    loop {
        message.clear();
        let mut section = file.by_ref().take(end(parser).map_or(u64::MAX, |end| end.saturating_sub(at)));
        let whole = if at == 0 {
            fill(&mut section, &mut message, FILE_HEADER)?
        } else {
            fill(&mut section, &mut message, MESSAGE_HEADER)? && {
                let length = MESSAGE_HEADER + usize::from(u16::from_le_bytes([message[0], message[1]]));
                fill(&mut section, &mut message, length)?
            }
        };
        if !whole {
            return Ok(message.is_empty());
        }
        if at > 0 && !lengths_fit(message[2], &message[MESSAGE_HEADER..]) {
            return Err(Stop::Framing(FramingError::Length(at)));
        }
        parser.consume_bytes(&message).map_err(Stop::Parser)?;
        at += message.len() as u64;
    }
}

/// Reads until `message` has `length` bytes. Returns whether there were enough bytes.
fn fill(section: &mut impl Read, message: &mut Vec<u8>, length: usize) -> io::Result<bool> {
    let missing = length - message.len();
    Ok(section.by_ref().take(missing as u64).read_to_end(message)? == missing)
}

/// Whether the content of a message is as long as the lengths inside it state.
fn lengths_fit(kind: u8, content: &[u8]) -> bool {
    match kind {
        // Subscription: instance, number, and a name that may be empty.
        b'A' => content.len() >= 3,
        // Parameter: length of its name, the name, the value.
        b'P' => content.first().is_some_and(|name| content.len() > usize::from(*name)),
        // The parser checks all other kinds.
        _ => true,
    }
}
