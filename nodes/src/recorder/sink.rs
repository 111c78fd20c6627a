//! Destination of the recorder's messages: the current file, or nothing while none can be written.

use std::time::{Duration, Instant};

use whirlstand_logs::{BenchMessage, Channel, Hole, LogWriter, PanelChannels, Panels, WriteError};
use whirlstand_msgs::Message;

use super::log_files::LogFiles;
use super::sync::Syncer;
use crate::error::NodeError;

/// Time between two attempts to begin a file after a write error.
const RETRY: Duration = Duration::from_millis(500);

/// Period in which nothing can be written.
struct Outage {
    hole: Hole,
    retry: Instant,
}

/// Destination of the recorder's messages.
pub(super) struct Sink {
    files: LogFiles,
    /// Writer of the current file; `None` in an outage, and after the end.
    log: Option<LogWriter>,
    /// Messages in formats that panels of log viewers understand, derived from the recorded ones.
    panels: Panels,
    /// Channels of these messages in the current file.
    panel_channels: Option<PanelChannels>,
    outage: Option<Outage>,
    syncer: Syncer,
    /// Latest bench time of a message, ns.
    latest_ns: u64,
    /// Bench time at which the current file begins; `None` before its first message.
    began_ns: Option<u64>,
    /// Number of messages in earlier files.
    before: u64,
    /// Number of messages that could not be written.
    missed: u64,
}

impl Sink {
    /// Begins the first file.
    ///
    /// # Errors
    /// The file cannot be created.
    pub(super) fn open(mut files: LogFiles, panels: Panels) -> Result<Self, NodeError> {
        let system = |source| NodeError::System { action: "start the thread that syncs the log", source };
        let syncer = Syncer::start().map_err(system)?;
        let log = files.next()?;
        let mut sink = Self {
            files,
            log: None,
            panels,
            panel_channels: None,
            outage: None,
            syncer,
            latest_ns: 0,
            began_ns: None,
            before: 0,
            missed: 0,
        };
        sink.follow(log);
        Ok(sink)
    }

    /// Files of the recorder.
    pub(super) fn files(&self) -> &LogFiles {
        &self.files
    }

    /// Number of messages written, over all files.
    pub(super) fn written(&self) -> u64 {
        self.before + self.log.as_ref().map_or(0, LogWriter::messages)
    }

    /// Number of messages that could not be written.
    pub(super) fn missed(&self) -> u64 {
        self.missed
    }

    fn follow(&mut self, log: LogWriter) {
        if let Ok(file) = log.file() {
            self.syncer.follow(file);
        }
        self.began_ns = None;
        self.panels.begin_anew();
        let log = self.log.insert(log);
        match PanelChannels::open(log) {
            Ok(channels) => self.panel_channels = Some(channels),
            Err(error) => self.break_off(&error),
        }
    }

    /// Marks the beginning of a new run of the plant.
    pub(super) fn begin_run(&mut self) {
        self.panels.begin_run();
    }

    /// Channel for `M` in the current file; `None` without a file.
    pub(super) fn channel<M: Message>(&mut self) -> Option<Channel<M>> {
        match self.log.as_mut()?.channel() {
            Ok(channel) => Some(channel),
            Err(error) => {
                self.break_off(&error);
                None
            }
        }
    }

    /// Writes a message, or counts it as missing.
    pub(super) fn write<M: Message>(&mut self, channel: Option<&Channel<M>>, message: &M)
    where
        BenchMessage: From<M>,
    {
        let stamp_ns = message.head().stamp_ns;
        if M::TOPIC != whirlstand_msgs::Health::TOPIC {
            self.latest_ns = stamp_ns;
            self.began_ns.get_or_insert(stamp_ns);
        }
        let Some((log, channel)) = self.log.as_mut().zip(channel) else { return self.miss(1) };
        if let Err(error) = log.write(channel, message) {
            self.break_off(&error);
            return self.miss(1);
        }
        let Some(channels) = &mut self.panel_channels else { return };
        let mut written = Ok(());
        self.panels.hear(&(*message).into(), |ns, panel| {
            if written.is_ok() {
                written = channels.write(log, ns, &panel);
            }
        });
        if let Err(error) = written {
            self.break_off(&error);
        }
    }

    fn miss(&mut self, messages: u64) {
        self.missed += messages;
        if let Some(outage) = &mut self.outage {
            outage.hole.messages += messages;
        }
    }

    /// Abandons the current file.
    fn break_off(&mut self, error: &WriteError) {
        let Some(log) = self.log.take() else { return };
        self.panel_channels = None;
        self.syncer.close();
        self.give_up(log.messages(), log.unflushed(), error);
    }

    /// Counts the messages missing in a file that cannot be written, and reports the reason once.
    fn give_up(&mut self, messages: u64, unflushed: u64, error: &WriteError) {
        self.before += messages - unflushed;
        let from_ns = self.latest_ns;
        let outage = self.outage.get_or_insert_with(|| {
            tracing::error!("{error}; the log has a gap from here until a new file can be written");
            let hole = Hole { from_ns, until_ns: 0, messages: 0, reason: error.reason() };
            Outage { hole, retry: Instant::now() }
        });
        outage.retry = Instant::now() + RETRY;
        self.miss(unflushed);
    }

    /// Flushes waiting messages to the system when they have waited long enough.
    pub(super) fn flush_if_due(&mut self, now: Instant) {
        if let Some(Err(error)) = self.log.as_mut().map(|log| log.flush_if_due(now)) {
            self.break_off(&error);
        }
        if let Some(source) = self.syncer.failure() {
            self.break_off(&WriteError::Write { path: self.files.current().into(), source: source.into() });
        }
    }

    /// True when the next file must begin: the current one has reached its size or its length, or none could
    /// be written for a time.
    pub(super) fn is_file_due(&self, now: Instant) -> bool {
        let Some(log) = &self.log else {
            return self.outage.as_ref().is_some_and(|outage| now >= outage.retry);
        };
        let limits = self.files.limits();
        let length_ns = self.began_ns.map_or(0, |began| self.latest_ns.saturating_sub(began));
        limits.duration_ns.is_some_and(|most| length_ns >= most)
            || limits.bytes.is_some_and(|most| log.bytes().is_ok_and(|bytes| bytes >= most))
    }

    /// Ends the current file, if any, and begins the next. False when it cannot be written.
    pub(super) fn begin_file(&mut self) -> bool {
        if let Some(log) = self.log.take() {
            let (messages, unflushed) = (log.messages(), log.unflushed());
            match log.finish_unsynced() {
                Ok(_) => self.before += messages,
                Err(error) => self.give_up(messages, unflushed, &error),
            }
            self.syncer.close();
        }
        match self.next_file() {
            Ok(log) => {
                if self.outage.take().is_some() {
                    tracing::warn!(path = %self.files.current().display(), "the log continues in a new file");
                }
                self.follow(log);
                true
            }
            Err(error) => {
                self.give_up(0, 0, &error);
                false
            }
        }
    }

    /// Creates the next file, with a description of the hole before it.
    fn next_file(&mut self) -> Result<LogWriter, WriteError> {
        let mut log = self.files.next()?;
        if let Some(outage) = &self.outage {
            let hole = Hole { until_ns: self.latest_ns, ..outage.hole.clone() };
            if let Err(error) = log.tell_hole(&hole) {
                self.files.discard();
                return Err(error);
            }
        }
        Ok(log)
    }

    /// Ends the log.
    ///
    /// # Errors
    /// A part of the log could not be written.
    pub(super) fn finish(&mut self) -> Result<(), NodeError> {
        if let Some(log) = self.log.take() {
            let (messages, unflushed) = (log.messages(), log.unflushed());
            match log.finish() {
                Ok(_) => self.before += messages,
                Err(error) => self.give_up(messages, unflushed, &error),
            }
        }
        match self.outage.take() {
            None => Ok(()),
            Some(outage) => Err(NodeError::LogEndMissing(Hole { until_ns: self.latest_ns, ..outage.hole })),
        }
    }
}
