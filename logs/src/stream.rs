//! The messages of an MCAP log in file order, over all its files.
//!
//! A recorder that was restarted, or whose file reached its size limit, continues in another file: see
//! [`crate::segments`].

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use whirlstand_msgs::Message;

use crate::hole::Hole;
use crate::log_file::{AttachedFile, Damage, Ending, LogFile, Step, Topic};
use crate::read_error::ReadError;
use crate::segments::log_files;
use crate::writer::CDR_HEADER;

/// A message as stored in the log.
#[derive(Debug, Clone, Copy)]
pub struct RawMessage<'a> {
    /// Its topic.
    pub topic: &'a Arc<Topic>,
    /// Sequence number, 32 bits.
    pub sequence: u32,
    /// Time on the log's axis, ns.
    pub log_time: u64,
    /// Time set by the publisher, ns.
    pub publish_time: u64,
    /// Encoded content.
    pub data: &'a [u8],
}

impl RawMessage<'_> {
    /// Decodes the message into the type that its topic holds.
    ///
    /// # Errors
    /// [`ReadError::Schema`] when the topic holds another type, [`ReadError::Length`] when the number of bytes
    /// does not fit.
    pub fn decode<M: Message>(&self) -> Result<M, ReadError> {
        check_schema::<M>(self.topic)?;
        decode_unchecked(self)
    }
}

/// Decodes the bytes of a message whose schema has been checked.
pub(crate) fn decode_unchecked<M: Message>(message: &RawMessage<'_>) -> Result<M, ReadError> {
    message
        .data
        .strip_prefix(&CDR_HEADER)
        .and_then(|body| bytemuck::try_pod_read_unaligned(body).ok())
        .ok_or_else(|| ReadError::Length {
            topic: message.topic.name.clone(),
            found: message.data.len(),
            expected: M::TYPE_NAME,
            length: size_of::<M>() + CDR_HEADER.len(),
        })
}

/// Checks that a topic holds `M` in this program's version.
pub(crate) fn check_schema<M: Message>(topic: &Topic) -> Result<(), ReadError> {
    let same_name = topic.schema_name == M::TYPE_NAME;
    if same_name && topic.message_encoding == "cdr" && topic.layout == M::SCHEMA.as_bytes() {
        return Ok(());
    }
    let name = if topic.schema_name.is_empty() { "messages without a schema" } else { &topic.schema_name };
    let found = if same_name { format!("{name} with other fields or encoding") } else { name.to_string() };
    Err(ReadError::Schema { topic: topic.name.clone(), found, expected: M::TYPE_NAME })
}

/// Reads a log from its first file's start to its last file's end.
pub struct LogStream {
    waiting: VecDeque<PathBuf>,
    current: LogFile,
    current_path: PathBuf,
    /// Location of the last returned message, whose bytes are in the current file.
    entry: Option<crate::log_file::Entry>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    attached: Vec<AttachedFile>,
    damage: Vec<Damage>,
    endings: Vec<(PathBuf, Ending)>,
    ended: bool,
}

impl LogStream {
    /// Opens a log, and its later files if there are any.
    ///
    /// # Errors
    /// [`ReadError::Io`], [`ReadError::NotMcap`] and [`ReadError::NoLog`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ReadError> {
        let mut waiting = VecDeque::from(log_files(path)?);
        // `log_files` always names the first file.
        let current_path = waiting.pop_front().unwrap_or_default();
        Ok(Self {
            waiting,
            current: LogFile::open(&current_path)?,
            current_path,
            entry: None,
            metadata: Vec::new(),
            attached: Vec::new(),
            damage: Vec::new(),
            endings: Vec::new(),
            ended: false,
        })
    }

    /// The next message, or `None` at the end of the last file. Damaged records and cut-off ends are skipped
    /// and reported by [`Self::damage`] and [`Self::endings`].
    ///
    /// # Errors
    /// [`ReadError::Io`], and [`ReadError::NotMcap`] for a later file.
    #[expect(clippy::should_implement_trait, reason = "the message borrows from the stream")]
    pub fn next(&mut self) -> Result<Option<RawMessage<'_>>, ReadError> {
        while !self.ended {
            self.entry = self.current.entries.pop_front();
            if self.entry.is_some() {
                break;
            }
            self.advance()?;
        }
        Ok(self.entry.as_ref().map(|e| RawMessage {
            topic: &e.topic,
            sequence: e.sequence,
            log_time: e.log_time,
            publish_time: e.publish_time,
            data: &self.current.data[e.data.clone()],
        }))
    }

    fn advance(&mut self) -> Result<(), ReadError> {
        match self.current.next()? {
            Step::Messages => {}
            Step::Metadata(name, map) => self.metadata.push((name, map)),
            // Every file of a log contains the launch file and the vehicle, so repetitions are skipped.
            Step::Attached(file) if self.attached.contains(&file) => {}
            Step::Attached(file) => self.attached.push(file),
            Step::End(ending) => {
                self.endings.push((self.current_path.clone(), ending));
                self.damage.append(&mut self.current.damage);
                match self.waiting.pop_front() {
                    Some(path) => {
                        self.current = LogFile::open(&path)?;
                        self.current_path = path;
                    }
                    None => {
                        self.entry = None;
                        self.ended = true;
                    }
                }
            }
        }
        Ok(())
    }

    /// Holes in the log, as far as the files read so far report them.
    pub fn holes(&self) -> impl Iterator<Item = Hole> {
        let holes = self.metadata.iter().filter(|(name, _)| name == Hole::METADATA_NAME);
        holes.map(|(_, map)| Hole::from_map(map))
    }

    /// Metadata records read so far: name and texts.
    pub fn metadata(&self) -> &[(String, BTreeMap<String, String>)] {
        &self.metadata
    }

    /// Attached files read so far.
    pub fn attached(&self) -> &[AttachedFile] {
        &self.attached
    }

    /// Damaged parts of the files that have been read to their end.
    pub fn damage(&self) -> &[Damage] {
        &self.damage
    }

    /// The files that have been read to their end, and the state of each end.
    pub fn endings(&self) -> &[(PathBuf, Ending)] {
        &self.endings
    }

    /// The file being read.
    pub fn path(&self) -> &Path {
        &self.current_path
    }
}
