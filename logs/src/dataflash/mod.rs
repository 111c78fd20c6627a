//! ArduPilot DataFlash: signals `MESSAGE.Field`, further sensors of one kind `MESSAGE.1.Field`, array elements
//! `MESSAGE.Field[2]`.
//!
//! Units and scales are those of the log's own UNIT, MULT and FMTU messages; in logs before these existed, only the
//! scale of the field's type is known, and a mapping states the unit. Time is the messages' own `TimeUS` or `TimeMS`. The
//! layout is that of ArduPilot's `AP_Logger`, "LogStructure.h".

mod definitions;
mod format;
mod framing;

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use self::definitions::Definitions;
use self::format::{DEFINITION, Format};
use self::framing::{Gaps, Message, Messages};
use crate::mapping::{Mapping, Source};
use crate::multi::{Collector, MultiError};
use crate::record::Record;
use crate::topics::{TopicSamples, Topics};

/// Bytes with which a log begins: the header of the first definition.
pub const MAGIC: [u8; 3] = [0xa3, 0x95, DEFINITION];

/// A time step to the message before that is longer than this means a damaged time, unless the next message
/// confirms it. Tasks of the autopilot write at least once a second; a pause in the log is confirmed.
const LONGEST_STEP_NS: u64 = 60_000_000_000;

/// Why a DataFlash log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DataflashError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file contains no complete definition of a message.
    #[error(
        "{path}: there is no complete message definition (FMT) from byte {at} on, so it cannot be read: this is not a DataFlash log, or it is damaged. Download the log from the autopilot again"
    )]
    NoDefinition {
        /// The file.
        path: PathBuf,
        /// Where the search began.
        at: u64,
    },
    /// The file has the framing of a DataFlash log, and the times of PX4's format before ULog.
    #[error(
        "{path}: this is a log of PX4's sdlog2 (.px4log), which was replaced by ULog in 2016 and is not read; convert it to CSV, for example by pymavlink's mavlogdump.py --format csv, and give that"
    )]
    Sdlog2 {
        /// The file.
        path: PathBuf,
    },
    /// The signals cannot form a record.
    #[error(transparent)]
    Multi(#[from] MultiError),
}

/// Lists the topics of a DataFlash log with their signals.
///
/// # Errors
/// [`DataflashError`].
pub fn dataflash_topics(path: &Path) -> Result<Topics, DataflashError> {
    Log::open(path)?.topics()
}

/// Reads the mapped signals of a DataFlash log and resamples them to the clock of the fastest one.
///
/// # Errors
/// [`DataflashError`].
pub fn read_dataflash(path: &Path, mappings: &[Mapping]) -> Result<Record, DataflashError> {
    let log = Log::open(path)?;
    let topics = log.topics()?;
    let mut collector = Collector::new(path, &topics.sources(), &topics.remarks, mappings)?;
    log.each(&mut |topic, message, time| {
        if !collector.wants(&topic.name) {
            return;
        }
        for signal in &topic.signals {
            let field = &message.format.fields[signal.field];
            if let Some(value) = field.number(message.content, signal.element) {
                collector.take(&signal.source.name, time, value * signal.scale);
            }
        }
    })?;
    Ok(collector.finish(&topics.remarks)?)
}

/// A log whose definitions have been read.
struct Log<'a> {
    path: &'a Path,
    definitions: Definitions,
    /// The first time that the following message confirms, ns.
    start: Option<u64>,
    remarks: Vec<String>,
}

/// Messages of one type and one sensor.
struct Topic {
    name: String,
    signals: Vec<Signal>,
}

/// A number in the messages of a topic.
struct Signal {
    source: Source,
    field: usize,
    element: usize,
    scale: f64,
}

impl<'a> Log<'a> {
    /// Reads the definitions of a log.
    fn open(path: &'a Path) -> Result<Self, DataflashError> {
        let failed = |source| DataflashError::Io { path: path.into(), source };
        let mut messages = Messages::new(File::open(path).map_err(failed)?);
        let mut definitions = Definitions::default();
        let mut clock = Clock::default();
        while let Some(message) = messages.next().map_err(failed)? {
            definitions.take(&message);
            if let Some(time) = message.format.time_ns(message.content) {
                clock.confirms(time);
            }
        }
        if messages.formats().count() < 2 {
            return Err(DataflashError::NoDefinition { path: path.into(), at: 0 });
        }
        let start = clock.start.or(clock.unconfirmed);
        if start.is_none() && messages.formats().any(Format::is_sdlog2_time) {
            return Err(DataflashError::Sdlog2 { path: path.into() });
        }
        let mut remarks = gap_remarks(path, messages.gaps());
        remarks.extend(messages.formats().filter_map(|format| {
            let letter = format.unknown?;
            Some(format!(
                "{} has fields of the unknown type '{letter}': these and the following ones are not read",
                format.name
            ))
        }));
        Ok(Self { path, definitions, start, remarks })
    }

    fn topics(&self) -> Result<Topics, DataflashError> {
        let mut by_name: BTreeMap<String, TopicSamples> = BTreeMap::new();
        let left_out = self.each(&mut |topic, _, time| {
            let samples = match by_name.get_mut(&topic.name) {
                Some(samples) => samples,
                None => by_name.entry(topic.name.clone()).or_insert_with(|| TopicSamples {
                    signals: topic.signals.iter().map(|signal| signal.source.clone()).collect(),
                    times_ns: Vec::new(),
                }),
            };
            samples.times_ns.push(time);
        })?;
        let mut remarks = self.remarks.clone();
        if left_out > 0 {
            let path = self.path.display();
            remarks.push(format!(
                "{path}: {left_out} messages are left out because their times are inconsistent with their neighbours"
            ));
        }
        Ok(Topics { by_name, remarks })
    }

    /// Visits every sample message with its time in ns. Returns how many messages have an impossible time.
    fn each(&self, visit: &mut dyn FnMut(&Topic, &Message<'_>, u64)) -> Result<u64, DataflashError> {
        let failed = |source| DataflashError::Io { path: self.path.into(), source };
        let mut messages = Messages::new(File::open(self.path).map_err(failed)?);
        let mut topics: HashMap<(u8, u8), Topic> = HashMap::new();
        let mut definitions = 0;
        let mut clock = Clock { last: self.start, ..Clock::default() };
        let mut left_out = 0;
        while let Some(message) = messages.next().map_err(failed)? {
            let Some(time) = message.format.time_ns(message.content) else { continue };
            if !clock.confirms(time) {
                left_out += 1;
            } else if Definitions::is_topic(message.format) {
                if message.definitions != definitions {
                    definitions = message.definitions;
                    topics.clear();
                }
                let instance = self.instance(&message);
                let topic = topics
                    .entry((message.format.kind, instance))
                    .or_insert_with(|| self.topic(message.format, instance));
                visit(topic, &message, time);
            }
        }
        Ok(left_out)
    }

    /// Number of the sensor, 0 for the first or only one.
    fn instance(&self, message: &Message<'_>) -> u8 {
        let number = || {
            let field = self.definitions.instance(message.format)?;
            message.format.fields[field].number(message.content, 0)
        };
        number().map_or(0, |number| number as u8)
    }

    fn topic(&self, format: &Format, instance: u8) -> Topic {
        let name = match instance {
            0 => format.name.clone(),
            instance => format!("{}.{instance}", format.name),
        };
        let mut signals = Vec::new();
        // The first field is the time.
        for (at, field) in format.fields.iter().enumerate().skip(1) {
            for element in 0..field.numbers() {
                let index = if field.numbers() > 1 { format!("[{element}]") } else { String::new() };
                let source = Source {
                    name: format!("{name}.{}{index}", field.label),
                    unit: self.definitions.unit(format, at),
                };
                signals.push(Signal {
                    source,
                    field: at,
                    element,
                    scale: self.definitions.scale(format, at),
                });
            }
        }
        Topic { name, signals }
    }
}

/// Checks the times of messages against each other, since no checksum reveals a damaged one.
#[derive(Default)]
struct Clock {
    /// The first time that the following message confirmed, ns.
    start: Option<u64>,
    /// The last time that fitted, ns.
    last: Option<u64>,
    /// The last time that did not fit, ns.
    unconfirmed: Option<u64>,
}

impl Clock {
    /// Whether a time fits those before it.
    fn confirms(&mut self, time: u64) -> bool {
        let near = |other: Option<u64>| other.is_some_and(|other| other.abs_diff(time) <= LONGEST_STEP_NS);
        if near(self.last) || near(self.unconfirmed) {
            self.start = self.start.or(self.unconfirmed);
            self.last = Some(time);
            self.unconfirmed = None;
            true
        } else {
            self.unconfirmed = Some(time);
            false
        }
    }
}

/// Sentences on bytes that are no messages.
fn gap_remarks(path: &Path, gaps: Gaps) -> Vec<String> {
    let path = path.display();
    let damage = (gaps.places > 0).then(|| {
        format!(
            "{path} is damaged: {} bytes in {} places are not valid messages, the first at byte {}; their data are missing",
            gaps.bytes, gaps.places, gaps.first
        )
    });
    let cut = gaps.cut.map(|at| {
        format!("{path} ends in the middle of the message at byte {at}: the logger lost power or was stopped")
    });
    damage.into_iter().chain(cut).collect()
}
