//! A log of this program: its bench, and its messages by type.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use whirlstand_msgs::Message;

use crate::bench_info::{BenchInfo, LAUNCH_ATTACHMENT, METADATA_NAME, VEHICLE_ATTACHMENT};
use crate::log_file::AttachedFile;
use crate::read_error::ReadError;
use crate::stream::{LogStream, check_schema, decode_unchecked};

/// An MCAP log whose beginning has been read.
#[derive(Debug, Clone)]
pub struct Log {
    path: PathBuf,
    info: Option<BenchInfo>,
    attached: Vec<AttachedFile>,
}

impl Log {
    /// Opens a log; a folder stands for its file `log.mcap`.
    ///
    /// # Errors
    /// [`ReadError`], among them [`ReadError::BenchInfo`] when the log is of this program and the description
    /// of its bench is damaged.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, ReadError> {
        let path = path.as_ref().to_path_buf();
        let mut stream = LogStream::open(&path)?;
        // The description of the bench comes before the first message.
        stream.next()?;
        let info = stream
            .metadata()
            .iter()
            .find(|(name, _)| name == METADATA_NAME)
            .map(|(_, map)| BenchInfo::from_map(map))
            .transpose()
            .map_err(|reason| ReadError::BenchInfo { path: path.clone(), reason })?;
        Ok(Self { path, info, attached: stream.attached().to_vec() })
    }

    /// The file or folder that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The bench that recorded the log; `None` for a log of another program.
    pub fn info(&self) -> Option<&BenchInfo> {
        self.info.as_ref()
    }

    /// Files attached inside the log.
    pub fn attached(&self) -> &[AttachedFile] {
        &self.attached
    }

    /// The launch file's text.
    pub fn launch_text(&self) -> Option<&str> {
        self.text(LAUNCH_ATTACHMENT)
    }

    /// The vehicle file's text.
    pub fn vehicle_text(&self) -> Option<&str> {
        self.text(VEHICLE_ATTACHMENT)
    }

    fn text(&self, name: &str) -> Option<&str> {
        self.attached.iter().find(|a| a.name == name).and_then(|a| std::str::from_utf8(&a.data).ok())
    }

    /// All messages, in file order.
    ///
    /// # Errors
    /// [`ReadError::Io`] when the file no longer exists.
    pub fn stream(&self) -> Result<LogStream, ReadError> {
        LogStream::open(&self.path)
    }

    /// The messages of type `M` on its own topic, in file order.
    ///
    /// # Errors
    /// [`ReadError::Io`] when the file no longer exists.
    pub fn messages<M: Message>(&self) -> Result<Messages<M>, ReadError> {
        self.messages_on(M::TOPIC)
    }

    /// The messages of type `M` on another topic.
    ///
    /// # Errors
    /// [`ReadError::Io`] when the file no longer exists.
    pub fn messages_on<M: Message>(&self, topic: &str) -> Result<Messages<M>, ReadError> {
        let topic = format!("/{}", topic.trim_start_matches('/'));
        Ok(Messages { stream: self.stream()?, topic, checked: false, message: PhantomData })
    }
}

/// Iterator over the messages of one topic.
pub struct Messages<M> {
    stream: LogStream,
    topic: String,
    checked: bool,
    message: PhantomData<fn() -> M>,
}

impl<M: Message> Iterator for Messages<M> {
    type Item = Result<M, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let message = match self.stream.next() {
                Ok(message) => message?,
                Err(error) => return Some(Err(error)),
            };
            if message.topic.name != self.topic {
                continue;
            }
            if !self.checked {
                if let Err(error) = check_schema::<M>(message.topic) {
                    return Some(Err(error));
                }
                self.checked = true;
            }
            return Some(decode_unchecked(&message));
        }
    }
}
