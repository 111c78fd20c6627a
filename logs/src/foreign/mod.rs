//! MCAP logs of other programs: signals `/topic.field.path`, array elements `/topic.field[3]`.
//!
//! The supported encodings are `json`, `cdr` with `ros2msg` schemas, `ros1` with `ros1msg` schemas, and `protobuf`
//! with embedded descriptors. Not supported are `flatbuffer`, `cbor`, `cdr` with IDL schemas, and wide strings;
//! topics in these are skipped, and reported when a signal is missing. Only numbers and booleans are signals;
//! arrays of more than 256 elements (images, point clouds) are skipped. Time is the log time.

mod decoder;
mod ros;
mod visit;
mod wire;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;

use crate::log::Log;
use crate::log_file::Topic;
use crate::mapping::{Mapping, Source};
use crate::multi::{Collector, MultiError};
use crate::read_error::ReadError;
use crate::record::Record;

use decoder::Decoder;

/// Number of messages of a topic from which its fields are learnt; arrays may change their length from
/// message to message.
const LEARNT_FROM: u64 = 20;

/// Why a log of another program cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ForeignError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The signals cannot form a record.
    #[error(transparent)]
    Multi(#[from] MultiError),
}

/// The signals in a log of another program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Catalogue {
    /// Names of all signals, topic by topic.
    pub signals: Vec<String>,
    /// Topics that cannot be read, each with the reason.
    pub unreadable: Vec<String>,
}

/// Decoders by topic; an error is the reason why there is none.
#[derive(Default)]
struct Decoders {
    by_topic: HashMap<*const Topic, Result<Decoder, String>>,
    // Keeps the topics alive, so that their addresses used as keys stay unique.
    topics: Vec<Arc<Topic>>,
}

impl Decoders {
    fn get(&mut self, topic: &Arc<Topic>) -> &Result<Decoder, String> {
        self.by_topic.entry(Arc::as_ptr(topic)).or_insert_with(|| {
            self.topics.push(Arc::clone(topic));
            Decoder::new(topic)
        })
    }
}

/// Lists the signals of a log.
///
/// # Errors
/// [`ReadError`].
pub fn catalogue(log: &Log) -> Result<Catalogue, ReadError> {
    let mut stream = log.stream()?;
    let mut decoders = Decoders::default();
    let mut seen: BTreeMap<String, u64> = BTreeMap::new();
    let mut signals: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut unreadable = BTreeSet::new();
    while let Some(message) = stream.next()? {
        let name = &message.topic.name;
        if seen.get(name).is_some_and(|n| *n >= LEARNT_FROM) {
            continue;
        }
        *seen.entry(name.clone()).or_default() += 1;
        let fields = signals.entry(name.clone()).or_default();
        let mut visit = |path: &str, _: f64| {
            let signal = format!("{name}.{path}");
            if !fields.contains(&signal) {
                fields.push(signal);
            }
        };
        let read = match decoders.get(message.topic) {
            Ok(decoder) => decoder.visit(message.data, &mut visit),
            Err(reason) => Err(reason.clone()),
        };
        if let Err(reason) = read {
            unreadable.insert(format!("{name}: {reason}"));
        }
    }
    Ok(Catalogue {
        signals: signals.into_values().flatten().collect(),
        unreadable: unreadable.into_iter().collect(),
    })
}

/// Reads the mapped signals of a log and resamples them to the clock of the fastest one.
///
/// # Errors
/// [`ForeignError`].
pub fn read_foreign(path: &Path, mappings: &[Mapping]) -> Result<Record, ForeignError> {
    let log = Log::open(path)?;
    let Catalogue { signals, unreadable } = catalogue(&log)?;
    let offered: Vec<Source> = signals.into_iter().map(Source::without_unit).collect();
    let mut collector = Collector::new(path, &offered, &unreadable, mappings)?;
    let mut stream = log.stream()?;
    let mut decoders = Decoders::default();
    let mut source = String::new();
    while let Some(message) = stream.next()? {
        if !collector.wants(&message.topic.name) {
            continue;
        }
        let Ok(decoder) = decoders.get(message.topic) else { continue };
        let mut visit = |path: &str, value: f64| {
            source.clear();
            source.push_str(&message.topic.name);
            source.push('.');
            source.push_str(path);
            collector.take(&source, message.log_time, value);
        };
        // A message that cannot be read was reported by the catalogue, or its signal lacks a sample.
        let _ = decoder.visit(message.data, &mut visit);
    }
    Ok(collector.finish(&unreadable)?)
}
