//! Bus messages into MCAP, as Foxglove and PlotJuggler read it.
//!
//! ```no_run
//! use std::time::Instant;
//! use whirlstand_logs::{BenchInfo, LogWriter};
//! use whirlstand_msgs::{Imu, Message};
//!
//! # fn main() -> Result<(), whirlstand_logs::WriteError> {
//! let mut log = LogWriter::create("log.mcap", &BenchInfo::default())?;
//! let imu = log.channel::<Imu>()?;
//! log.write(&imu, &Imu::zeroed())?;
//! log.flush_if_due(Instant::now())?;
//! log.finish()?;
//! # Ok(())
//! # }
//! ```
//!
//! Every message type has one channel: topic `/imu`, schema in ROS 2 message syntax with the vehicle's own names of states, inputs
//! and outputs, messages in CDR. A message is its memory image behind the CDR header, because no message has padding. Messages are gathered in chunks,
//! compressed with LZ4, and a chunk goes to the operating system in one piece: what a killed recorder leaves is
//! whole up to the last flush.

use std::collections::BTreeMap;
use std::fs::File;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions};
use whirlstand_msgs::Message;

use crate::bench_info::{BenchInfo, METADATA_NAME};
use crate::hole::Hole;
use crate::named_schema::named_schema;
use crate::output::Output;
use crate::wall_clock::carries_wall_clock;

/// CDR, plain, in this machine's byte order (OMG DDS-RTPS 2.5, section 10.2.1.2): 0 is big-endian, 1 little-endian.
pub const CDR_HEADER: [u8; 4] = [0, cfg!(target_endian = "little") as u8, 0, 0];

/// Longest time that a message waits before its chunk goes to the file.
///
/// A quarter of a second keeps "readable up to the last second" true also when the machine stalls.
const FLUSH_INTERVAL: Duration = Duration::from_millis(250);

/// Size of a chunk, bytes: large enough to compress well, and small enough for a reader to hold; Foxglove
/// reads a chunk at a time.
const CHUNK_BYTES: u64 = 1 << 20;

/// The reason why a log cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file cannot be created.
    #[error("cannot create the log {path}: {source}")]
    Create {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file cannot be written, for example because the disk is full.
    #[error("cannot write the log {path}: {}", reason(source))]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the MCAP writer.
        source: McapError,
    },
}

impl WriteError {
    /// The reason without the file's name, such as `disk full`.
    pub fn reason(&self) -> String {
        match self {
            Self::Create { source, .. } => io_reason(source),
            Self::Write { source, .. } => reason(source),
        }
    }
}

/// The error in short form, with common names for errors that users know.
fn reason(error: &McapError) -> String {
    match error {
        McapError::Io(error) => io_reason(error),
        other => other.to_string(),
    }
}

fn io_reason(error: &std::io::Error) -> String {
    use std::io::ErrorKind;
    match error.kind() {
        ErrorKind::StorageFull => "disk full".into(),
        ErrorKind::QuotaExceeded => "disk quota exceeded".into(),
        ErrorKind::FileTooLarge => "the file reached the maximum size allowed by the system".into(),
        _ => error.to_string(),
    }
}

/// A topic of the log, for messages of type `M`.
#[derive(Debug)]
pub struct Channel<M> {
    id: u16,
    message: PhantomData<fn(&M)>,
}

/// A topic of the log whose messages are encoded elsewhere.
#[derive(Debug)]
pub struct EncodedChannel {
    id: u16,
    sequence: u32,
}

/// Size of a finished log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Written {
    /// Number of messages.
    pub messages: u64,
    /// Size of the file, bytes.
    pub bytes: u64,
}

/// Writes one MCAP file.
pub struct LogWriter {
    inner: mcap::Writer<Output>,
    path: PathBuf,
    info: BenchInfo,
    scratch: Vec<u8>,
    /// Latest bench time in the log, ns, which is used for messages that carry wall-clock time.
    bench_ns: u64,
    messages: u64,
    /// Messages that have been handed to the operating system.
    flushed: u64,
    next_flush: Option<Instant>,
    /// A handle of the file, for its size and for syncing.
    file: File,
}

impl LogWriter {
    /// Creates or replaces the file at `path`.
    ///
    /// # Errors
    /// [`WriteError`] when the file cannot be created or written.
    pub fn create(path: impl AsRef<Path>, info: &BenchInfo) -> Result<Self, WriteError> {
        Self::create_in_chunks(path, info, CHUNK_BYTES)
    }

    /// As [`Self::create`], with chunks of at most `chunk_bytes`, for a file that is to remain small.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn create_in_chunks(
        path: impl AsRef<Path>,
        info: &BenchInfo,
        chunk_bytes: u64,
    ) -> Result<Self, WriteError> {
        let path = path.as_ref().to_path_buf();
        let file = File::create(&path).map_err(|source| WriteError::Create { path: path.clone(), source })?;
        let options = WriteOptions::new()
            .library(concat!("whirlstand/", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(chunk_bytes.min(CHUNK_BYTES)))
            // Chunks are assembled in memory and written as a whole; nothing is patched in the file.
            .disable_seeking(true);
        let write = |source| WriteError::Write { path: path.clone(), source };
        let output = file.try_clone().map(Output::new).map_err(|e| write(e.into()))?;
        let mut inner = options.create(output).map_err(write)?;
        inner
            .write_metadata(&Metadata { name: METADATA_NAME.into(), metadata: info.to_map() })
            .map_err(write)?;
        inner.flush().map_err(write)?;
        Ok(Self {
            inner,
            path,
            info: info.clone(),
            scratch: Vec::with_capacity(1024),
            bench_ns: 0,
            messages: 0,
            flushed: 0,
            next_flush: None,
            file,
        })
    }

    /// Records in the log that messages before this position are missing. The entry is on disk when this
    /// returns.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn tell_hole(&mut self, hole: &Hole) -> Result<(), WriteError> {
        let metadata = Metadata { name: Hole::METADATA_NAME.into(), metadata: hole.to_map() };
        self.inner.write_metadata(&metadata).and_then(|()| self.inner.flush()).map_err(|e| self.failed(e))
    }

    /// Size of the file so far, bytes, without the messages that wait for their chunk.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn bytes(&self) -> std::io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Messages that were added since the last flush, and may not have reached the file.
    pub fn unflushed(&self) -> u64 {
        self.messages - self.flushed
    }

    /// Another handle of the file, for syncing it from another thread.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn file(&self) -> std::io::Result<File> {
        self.file.try_clone()
    }

    /// Attaches a file inside the log, for example the launch file. It is on disk when this returns.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> Result<(), WriteError> {
        let attachment = Attachment {
            log_time: self.bench_ns,
            create_time: 0,
            name: name.into(),
            media_type: media_type.into(),
            data: data.into(),
        };
        self.inner.attach(&attachment).and_then(|()| self.inner.flush()).map_err(|e| self.failed(e))
    }

    /// The channel for `M` under its own topic. A second call returns the same channel.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn channel<M: Message>(&mut self) -> Result<Channel<M>, WriteError> {
        self.channel_on(M::TOPIC)
    }

    /// The channel for `M` under another topic, for example `inject`.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn channel_on<M: Message>(&mut self, topic: &str) -> Result<Channel<M>, WriteError> {
        let topic = format!("/{}", topic.trim_start_matches('/'));
        let id = self
            .inner
            .add_schema(M::TYPE_NAME, "ros2msg", named_schema::<M>(&self.info).as_bytes())
            .and_then(|schema| self.inner.add_channel(schema, &topic, "cdr", &BTreeMap::new()))
            .map_err(|e| self.failed(e))?;
        Ok(Channel { id, message: PhantomData })
    }

    /// Adds a message; it reaches the file with its chunk.
    ///
    /// Its times are its bench time. Health and progress carry wall-clock time: they stand at the latest bench time in the
    /// log, so that the log has one clock; their own stamp is in the message.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn write<M: Message>(&mut self, channel: &Channel<M>, message: &M) -> Result<(), WriteError> {
        let head = message.head();
        let log_time = if carries_wall_clock(M::TOPIC) {
            self.bench_ns
        } else {
            self.bench_ns = self.bench_ns.max(head.stamp_ns);
            head.stamp_ns
        };
        let header = MessageHeader {
            channel_id: channel.id,
            // MCAP has 32-bit sequence numbers; the full number is in the message.
            sequence: head.seq as u32,
            log_time,
            publish_time: log_time,
        };
        self.scratch.clear();
        self.scratch.extend_from_slice(&CDR_HEADER);
        self.scratch.extend_from_slice(bytemuck::bytes_of(message));
        self.inner.write_to_known_channel(&header, &self.scratch).map_err(|e| self.failed(e))?;
        self.messages += 1;
        Ok(())
    }

    /// A channel whose messages are encoded elsewhere. `schema`: its name, its encoding and its content.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn encoded_channel(
        &mut self,
        topic: &str,
        schema: Option<(&str, &str, &[u8])>,
        message_encoding: &str,
    ) -> Result<EncodedChannel, WriteError> {
        let schema =
            schema.map_or(Ok(0), |(name, encoding, data)| self.inner.add_schema(name, encoding, data));
        let id = schema
            .and_then(|schema| self.inner.add_channel(schema, topic, message_encoding, &BTreeMap::new()))
            .map_err(|e| self.failed(e))?;
        Ok(EncodedChannel { id, sequence: 0 })
    }

    /// Adds an encoded message at a bench time, ns. It is derived from others, and not counted by
    /// [`Self::messages`].
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn write_encoded(
        &mut self,
        channel: &mut EncodedChannel,
        log_time: u64,
        data: &[u8],
    ) -> Result<(), WriteError> {
        let sequence = channel.sequence;
        channel.sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id: channel.id, sequence, log_time, publish_time: log_time };
        self.inner.write_to_known_channel(&header, data).map_err(|e| self.failed(e))
    }

    /// Number of messages of the bench that were added since the log was created.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Hands waiting messages to the operating system when they have waited for a quarter of a second. Call it
    /// at least that often; it costs a comparison when nothing is due.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn flush_if_due(&mut self, now: Instant) -> Result<bool, WriteError> {
        let due = *self.next_flush.get_or_insert(now + FLUSH_INTERVAL);
        if now < due {
            return Ok(false);
        }
        self.next_flush = Some(now + FLUSH_INTERVAL);
        if self.unflushed() == 0 {
            return Ok(false);
        }
        self.flush()?;
        Ok(true)
    }

    /// Passes all messages to the operating system now, so that they survive an end of this process.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn flush(&mut self) -> Result<(), WriteError> {
        self.inner.flush().map_err(|e| self.failed(e))?;
        self.flushed = self.messages;
        Ok(())
    }

    /// Writes index and footer, and syncs the file to disk.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn finish(self) -> Result<Written, WriteError> {
        let path = self.path.clone();
        let (written, file) = self.finish_unsynced()?;
        file.sync_all().map_err(|source| WriteError::Write { path, source: source.into() })?;
        Ok(written)
    }

    /// Writes index and footer. The caller has to sync the file, which takes as long as the disk needs.
    ///
    /// # Errors
    /// [`WriteError::Write`].
    pub fn finish_unsynced(mut self) -> Result<(Written, File), WriteError> {
        self.inner.finish().map_err(|e| self.failed(e))?;
        let bytes = self.bytes().map_err(|e| self.failed(e.into()))?;
        Ok((Written { messages: self.messages, bytes }, self.file))
    }

    fn failed(&self, source: McapError) -> WriteError {
        WriteError::Write { path: self.path.clone(), source }
    }
}
