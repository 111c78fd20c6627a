//! Reads one MCAP file from its start to its end, whether it is complete, cut off by a kill, or damaged in
//! between.
//!
//! Records are framed here (opcode, length, body; MCAP specification 1.0, "Records") and parsed by the `mcap`
//! crate. A length is accepted only as far as the file reaches, so that damaged bytes cost no memory.

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError};
use serde::Serialize;

use crate::named_schema::without_names;
use crate::read_error::ReadError;

/// Largest chunk that is decompressed, bytes. Tools write chunks of a few MB.
const MAX_CHUNK: usize = 256 << 20;

/// Length of a message's fields before its data: channel, sequence, log time, publish time.
const MESSAGE_HEAD: usize = 2 + 4 + 8 + 8;

/// A topic and the encoding of its messages.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Topic {
    /// Name, for example `/imu`.
    pub name: String,
    /// Message encoding, for example `cdr` or `json`.
    pub message_encoding: String,
    /// Name of the schema, for example `whirlstand/msg/Imu`; empty without a schema.
    pub schema_name: String,
    /// Encoding of the schema, for example `ros2msg` or `jsonschema`; empty without a schema.
    pub schema_encoding: String,
    /// Text of the schema.
    #[serde(skip)]
    pub schema: Vec<u8>,
    /// The schema without the names of a vehicle, as in [`whirlstand_msgs::Message::SCHEMA`].
    #[serde(skip)]
    pub layout: Vec<u8>,
}

/// A damaged part of a file that could not be read; the parts around it were read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// The file.
    pub file: PathBuf,
    /// Offset of the damaged record, bytes from the start of the file.
    pub offset: u64,
    /// Description of the damage.
    pub reason: String,
}

/// State of a file's end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// Complete, with footer and magic: the recorder finished the file.
    Complete,
    /// Truncated: the recorder was killed, or the file is still being written.
    Truncated,
}

/// Location of a message in [`LogFile::data`].
#[derive(Debug)]
pub(crate) struct Entry {
    pub topic: Arc<Topic>,
    pub sequence: u32,
    pub log_time: u64,
    pub publish_time: u64,
    pub data: Range<usize>,
}

/// An attached file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AttachedFile {
    /// Name, for example `launch.toml`.
    pub name: String,
    /// Media type, for example `application/toml`.
    pub media_type: String,
    /// Content.
    pub data: Vec<u8>,
}

/// Result of reading a record of the file.
pub(crate) enum Step {
    /// Messages: [`LogFile::entries`] has been refilled.
    Messages,
    /// Metadata: name and texts.
    Metadata(String, BTreeMap<String, String>),
    /// An attached file.
    Attached(AttachedFile),
    /// The file's end.
    End(Ending),
}

/// A file being read.
pub(crate) struct LogFile {
    path: PathBuf,
    file: BufReader<File>,
    offset: u64,
    length: u64,
    body: Vec<u8>,
    schemas: HashMap<u16, (String, String, Vec<u8>)>,
    topics: HashMap<u16, Arc<Topic>>,
    /// Channels that messages refer to but that the file does not define.
    unknown: HashSet<u16>,
    /// Messages of the present chunk, in file order.
    pub entries: VecDeque<Entry>,
    /// Bytes of these messages.
    pub data: Vec<u8>,
    /// Damaged parts found so far.
    pub damage: Vec<Damage>,
}

impl LogFile {
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.into(), source };
        let file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut file = BufReader::with_capacity(1 << 16, file);
        let mut magic = [0; 8];
        let empty = length == 0;
        if !empty && (file.read_exact(&mut magic).is_err() || magic != *MAGIC) {
            return Err(ReadError::NotMcap { path: path.into() });
        }
        Ok(Self {
            path: path.into(),
            file,
            offset: if empty { 0 } else { MAGIC.len() as u64 },
            length,
            body: Vec::new(),
            schemas: HashMap::new(),
            topics: HashMap::new(),
            unknown: HashSet::new(),
            entries: VecDeque::new(),
            data: Vec::new(),
            damage: Vec::new(),
        })
    }

    /// Reads records until one has a result.
    pub fn next(&mut self) -> Result<Step, ReadError> {
        self.entries.clear();
        self.data.clear();
        loop {
            let start = self.offset;
            let Some((opcode, length)) = self.read_record()? else {
                return Ok(Step::End(Ending::Truncated));
            };
            let body = std::mem::take(&mut self.body);
            let whole = body.len() as u64 == length;
            let step = self.record(opcode, &body, length);
            self.body = body;
            match step {
                Ok(Some(step)) => return Ok(step),
                Ok(None) => {}
                Err(error) if whole => self.damaged(start, describe(&error)),
                // The record is cut off; its readable part has been taken.
                Err(_) => {}
            }
            if !self.entries.is_empty() {
                return Ok(Step::Messages);
            }
        }
    }

    fn damaged(&mut self, offset: u64, reason: String) {
        self.damage.push(Damage { file: self.path.clone(), offset, reason });
    }

    /// Reads a body and returns its opcode and length; a chunk that the file's end cuts off is shorter. `None`
    /// at the end.
    fn read_record(&mut self) -> Result<Option<(u8, u64)>, ReadError> {
        const HEAD: u64 = 9;
        if self.length.saturating_sub(self.offset) < HEAD {
            return Ok(None);
        }
        let mut head = [0; HEAD as usize];
        self.file
            .read_exact(&mut head)
            .map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
        self.offset += HEAD;
        let mut length = [0; 8];
        length.copy_from_slice(&head[1..]);
        let mut wanted = u64::from_le_bytes(length);
        let available = self.length - self.offset;
        if wanted > available && head[0] == op::CHUNK {
            // Cut off, or a damaged length: the chunk's own head says how long it is as well. With that length
            // its checksum can be tested, and the records behind it are found.
            let own = self.length_in_chunk();
            let own = own.map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
            wanted = own.filter(|own| *own <= available).unwrap_or(wanted);
        }
        let take = wanted.min(available);
        // Only a chunk is useful in part.
        if wanted > available && head[0] != op::CHUNK {
            self.offset = self.length;
            return Ok(None);
        }
        self.body.clear();
        let read = self.file.by_ref().take(take).read_to_end(&mut self.body);
        read.map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
        self.offset += take;
        Ok(Some((head[0], wanted)))
    }

    /// Length of the chunk that starts here, as the fields at its start give it (MCAP specification 1.0, "Chunk":
    /// two times, uncompressed size, checksum, name of the compression, size of the records). `None` when the
    /// file ends before. The position in the file stays.
    fn length_in_chunk(&mut self) -> std::io::Result<Option<u64>> {
        const NAME: u64 = 8 + 8 + 8 + 4;
        let mut read = |at: u64, size: usize| {
            if self.offset + at + size as u64 > self.length {
                return Ok(None);
            }
            let mut bytes = [0; 8];
            self.file.seek(SeekFrom::Start(self.offset + at))?;
            self.file.read_exact(&mut bytes[..size])?;
            std::io::Result::Ok(Some(u64::from_le_bytes(bytes)))
        };
        let name = read(NAME, 4)?;
        let head = name.map(|length| NAME + 4 + length + 8);
        let records = head.map_or(Ok(None), |head| read(head - 8, 8))?;
        self.file.seek(SeekFrom::Start(self.offset))?;
        Ok(head.zip(records).and_then(|(head, records)| head.checked_add(records)))
    }

    fn record(&mut self, opcode: u8, body: &[u8], length: u64) -> Result<Option<Step>, McapError> {
        match opcode {
            op::CHUNK => self.chunk(body, length).map(|()| None),
            op::MESSAGE | op::SCHEMA | op::CHANNEL => self.data_record(opcode, body).map(|()| None),
            op::METADATA => match mcap::parse_record(opcode, body)? {
                Record::Metadata(m) => Ok(Some(Step::Metadata(m.name, m.metadata))),
                _ => Ok(None),
            },
            op::ATTACHMENT => Ok(Some(Step::Attached(attachment(body)?))),
            op::FOOTER => Ok(Some(Step::End(Ending::Complete))),
            // Indexes and statistics repeat data that have been read; private records belong to other
            // programs.
            _ => Ok(None),
        }
    }

    /// Decompresses a chunk. The checksum of a complete one must match before any of its contents count.
    fn chunk(&mut self, body: &[u8], length: u64) -> Result<(), McapError> {
        let mut options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_record_length_limit(MAX_CHUNK);
        options.prevalidate_chunk_crcs = body.len() as u64 == length;
        let mut reader = LinearReader::new_with_options(options);
        let mut head = [op::CHUNK, 0, 0, 0, 0, 0, 0, 0, 0];
        head[1..].copy_from_slice(&length.to_le_bytes());
        let mut input = head.as_slice().chain(body);
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(need) => {
                    // A damaged length must not reserve more memory than the data need.
                    let need = need.min(head.len() + body.len());
                    let read = input.read(reader.insert(need))?;
                    reader.notify_read(read);
                }
                LinearReadEvent::Record { opcode, data } => self.data_record(opcode, data)?,
            }
        }
        Ok(())
    }

    fn data_record(&mut self, opcode: u8, body: &[u8]) -> Result<(), McapError> {
        if opcode == op::MESSAGE {
            return self.message(body);
        }
        match mcap::parse_record(opcode, body)? {
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(c) => {
                let (schema_name, schema_encoding, schema) = match c.schema_id {
                    0 => Default::default(),
                    id => self
                        .schemas
                        .get(&id)
                        .cloned()
                        .ok_or_else(|| McapError::UnknownSchema(c.topic.clone(), id))?,
                };
                let layout = std::str::from_utf8(&schema).map(|text| without_names(text).into_bytes());
                let layout = layout.unwrap_or_else(|_| schema.clone());
                let topic = Topic {
                    layout,
                    name: c.topic,
                    message_encoding: c.message_encoding,
                    schema_name,
                    schema_encoding,
                    schema,
                };
                self.topics.insert(c.id, Arc::new(topic));
            }
            _ => {}
        }
        Ok(())
    }

    fn message(&mut self, body: &[u8]) -> Result<(), McapError> {
        let (head, data) = body.split_at_checked(MESSAGE_HEAD).ok_or(McapError::UnexpectedEof)?;
        let u64_at = |at: usize| head[at..at + 8].iter().rev().fold(0, |n, b| n << 8 | u64::from(*b));
        let channel = u16::from_le_bytes([head[0], head[1]]);
        let sequence = u32::from_le_bytes([head[2], head[3], head[4], head[5]]);
        let Some(topic) = self.topics.get(&channel) else {
            // The definition of the channel was in a damaged chunk; the other messages are still valid.
            if self.unknown.insert(channel) {
                let reason = McapError::UnknownChannel(sequence, channel).to_string();
                self.damaged(self.offset, reason);
            }
            return Ok(());
        };
        let start = self.data.len();
        self.data.extend_from_slice(data);
        self.entries.push_back(Entry {
            topic: Arc::clone(topic),
            sequence,
            log_time: u64_at(6),
            publish_time: u64_at(14),
            data: start..self.data.len(),
        });
        Ok(())
    }
}

/// Parses an attachment. The crate's parser assumes that the checksum at the end is present.
fn attachment(body: &[u8]) -> Result<AttachedFile, McapError> {
    let string_end = |at: usize| {
        let length = body.get(at..at + 4)?;
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
        Some(at + 4 + length)
    };
    let data = string_end(16).and_then(string_end).map(|end| end + 8);
    if data.is_none_or(|start| start + 4 > body.len()) {
        return Err(McapError::UnexpectedEof);
    }
    match mcap::parse_record(op::ATTACHMENT, body)? {
        Record::Attachment { header, data, .. } => {
            Ok(AttachedFile { name: header.name, media_type: header.media_type, data: data.into_owned() })
        }
        _ => Err(McapError::UnexpectedEof),
    }
}

/// The error with its cause: some of the crate's errors name only the operation that failed.
fn describe(error: &McapError) -> String {
    match std::error::Error::source(error) {
        Some(cause) => format!("{error}: {cause}").lines().next().unwrap_or_default().to_string(),
        None => error.to_string(),
    }
}
