//! PX4 ULog: signals `topic.field`, array elements `topic.field[2]`, further instances of a topic `topic.1.field`.
//!
//! The format is taken apart by the `px4-ulog` crate of the PX4 project. ULog states no units: a mapping does, where
//! they are not SI. Time is the samples' own `timestamp`.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Once;

use px4_ulog::stream_parser::model::{Completeness, DataMessage, FlattenedField, FlattenedFieldType as Type};
use px4_ulog::stream_parser::{Message, SimpleCallbackResult, read_file_with_simple_callback};

use crate::mapping::Mapping;
use crate::multi::{Collector, MultiError};
use crate::record::Record;

/// Why a ULog cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum UlogError {
    /// The file cannot be read, or its head and definitions are damaged.
    #[error("{path}: {reason}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Its signals do not make a record.
    #[error(transparent)]
    Multi(#[from] MultiError),
}

/// What a ULog offers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UlogCatalogue {
    /// Topics by name.
    pub topics: BTreeMap<String, UlogTopic>,
    /// How the file ends, when not as a finished one does.
    pub remark: Option<String>,
}

/// A topic of a ULog.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct UlogTopic {
    /// Names of its signals.
    pub signals: Vec<String>,
    /// Times of its samples, ns.
    pub times_ns: Vec<u64>,
}

/// Lists the topics of a ULog with their signals.
///
/// # Errors
/// [`UlogError::Read`].
pub fn ulog_catalogue(path: &Path) -> Result<UlogCatalogue, UlogError> {
    let mut topics: BTreeMap<String, UlogTopic> = BTreeMap::new();
    let remark = each(path, &mut |message| {
        let fields = message.flattened_format.fields.iter().filter(|f| is_signal(f));
        let topic = topics.entry(topic_name(message)).or_insert_with_key(|name| UlogTopic {
            signals: fields.map(|f| format!("{name}.{}", f.flattened_field_name)).collect(),
            times_ns: Vec::new(),
        });
        topic.times_ns.extend(time_ns(message));
    })?;
    Ok(UlogCatalogue { topics, remark })
}

/// Reads the mapped signals of a ULog onto the clock of the fastest of them.
///
/// # Errors
/// [`UlogError`].
pub fn read_ulog(path: &Path, mappings: &[Mapping]) -> Result<Record, UlogError> {
    let catalogue = ulog_catalogue(path)?;
    let signals = catalogue.topics.into_values().flat_map(|t| t.signals).collect();
    let mut collector = Collector::new(path, signals, &[], mappings)?;
    let remark = each(path, &mut |message| {
        let topic = topic_name(message);
        if !collector.wants(&topic) {
            return;
        }
        let Some(time) = time_ns(message) else { return };
        for field in message.flattened_format.fields.iter().filter(|f| is_signal(f)) {
            if let Some(value) =
                message.data.get(field.offset.into()..).and_then(|b| number(&field.field_type, b))
            {
                let source = format!("{topic}.{}", field.flattened_field_name);
                collector.take(&source, time, value);
            }
        }
    })?;
    Ok(collector.finish(&remark.into_iter().collect::<Vec<_>>())?)
}

/// Visits every sample, and says how the file ends when not as a finished one does.
fn each(path: &Path, visit: &mut dyn FnMut(&DataMessage<'_>)) -> Result<Option<String>, UlogError> {
    let failed = |reason: String| UlogError::Read { path: path.into(), reason };
    let text = path.to_str().ok_or_else(|| failed("the path is not UTF-8".into()))?;
    let mut callback = |message: &Message<'_>| {
        if let Message::Data(data) = message {
            visit(data);
        }
        SimpleCallbackResult::KeepReading
    };
    let Ok(read) = guarded(|| read_file_with_simple_callback(text, &mut callback)) else {
        return Err(failed("a message's own length leads outside it: the file is damaged".into()));
    };
    match read {
        Ok(Completeness::Complete) => Ok(None),
        Ok(Completeness::Truncated) => {
            Ok(Some(format!("{} ends in the middle: the logger lost power or was stopped", path.display())))
        }
        Ok(Completeness::MalformedRecord(reason)) => {
            Ok(Some(format!("{} is damaged and read up to there: {reason}", path.display())))
        }
        Err(error) => Err(failed(format!("not a readable ULog: {error}"))),
    }
}

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs the parser, which believes the lengths that a message gives and panics where they lie; such a panic is not told.
fn guarded<T>(read: impl FnOnce() -> T) -> std::thread::Result<T> {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        let told = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !GUARDED.get() {
                told(panic);
            }
        }));
    });
    GUARDED.set(true);
    // What the parser leaves half done goes with it; what was visited is not used after an error.
    let result = catch_unwind(AssertUnwindSafe(read));
    GUARDED.set(false);
    result
}

fn topic_name(message: &DataMessage<'_>) -> String {
    let name = &message.flattened_format.message_name;
    match message.multi_id.value() {
        0 => name.clone(),
        instance => format!("{name}.{instance}"),
    }
}

/// Time of a sample; the format has it in microseconds.
fn time_ns(message: &DataMessage<'_>) -> Option<u64> {
    let offset = message.flattened_format.timestamp_field.as_ref()?.offset;
    Some(unsigned::<8>(message.data.get(offset.into()..)?)?.saturating_mul(1000))
}

/// Texts are no signals, and the time is the time.
fn is_signal(field: &FlattenedField) -> bool {
    field.field_type != Type::Char && field.flattened_field_name != "timestamp"
}

fn unsigned<const N: usize>(bytes: &[u8]) -> Option<u64> {
    Some(bytes.get(..N)?.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)))
}

fn number(kind: &Type, bytes: &[u8]) -> Option<f64> {
    Some(match kind {
        Type::Int8 => f64::from(unsigned::<1>(bytes)? as i8),
        Type::UInt8 | Type::Bool | Type::Char => unsigned::<1>(bytes)? as f64,
        Type::Int16 => f64::from(unsigned::<2>(bytes)? as i16),
        Type::UInt16 => unsigned::<2>(bytes)? as f64,
        Type::Int32 => f64::from(unsigned::<4>(bytes)? as i32),
        Type::UInt32 => unsigned::<4>(bytes)? as f64,
        Type::Int64 => unsigned::<8>(bytes)? as i64 as f64,
        Type::UInt64 => unsigned::<8>(bytes)? as f64,
        Type::Float => f64::from(f32::from_bits(unsigned::<4>(bytes)? as u32)),
        Type::Double => f64::from_bits(unsigned::<8>(bytes)?),
    })
}
