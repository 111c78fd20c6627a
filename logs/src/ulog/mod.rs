//! PX4 ULog: signals `topic.field`, array elements `topic.field[2]`, further instances of a topic `topic.1.field`.
//!
//! The format is parsed by the `px4-ulog` crate of the PX4 project, after a check of the lengths that it trusts.
//! ULog states no units: a mapping states them where they are not SI. Time is the samples' own `timestamp`.

mod framing;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use px4_ulog::stream_parser::LogParser;
use px4_ulog::stream_parser::model::{Completeness, DataMessage, FlattenedField, FlattenedFieldType as Type};

use self::framing::read_sections;
use crate::mapping::{Mapping, Source};
use crate::multi::{Collector, MultiError};
use crate::record::Record;
use crate::topics::{TopicSamples, Topics};

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
    /// The signals cannot form a record.
    #[error(transparent)]
    Multi(#[from] MultiError),
}

/// Lists the topics of a ULog with their signals.
///
/// # Errors
/// [`UlogError::Read`].
pub fn ulog_topics(path: &Path) -> Result<Topics, UlogError> {
    let mut by_name: BTreeMap<String, TopicSamples> = BTreeMap::new();
    let remark = each(path, &mut |message| {
        let fields = message.flattened_format.fields.iter().filter(|f| is_signal(f));
        let topic = by_name.entry(topic_name(message)).or_insert_with_key(|name| TopicSamples {
            signals: fields
                .map(|f| Source::without_unit(format!("{name}.{}", f.flattened_field_name)))
                .collect(),
            times_ns: Vec::new(),
        });
        topic.times_ns.extend(time_ns(message));
    })?;
    Ok(Topics { by_name, remarks: remark.into_iter().collect() })
}

/// Reads the mapped signals of a ULog and resamples them to the clock of the fastest one.
///
/// # Errors
/// [`UlogError`].
pub fn read_ulog(path: &Path, mappings: &[Mapping]) -> Result<Record, UlogError> {
    let mut collector = Collector::new(path, &ulog_topics(path)?.sources(), &[], mappings)?;
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

/// Visits every sample. Returns a remark if the file does not end like a finished one.
fn each(path: &Path, visit: &mut dyn FnMut(&DataMessage<'_>)) -> Result<Option<String>, UlogError> {
    let failed = |reason: String| UlogError::Read { path: path.into(), reason };
    let mut file = BufReader::new(File::open(path).map_err(|e| failed(e.to_string()))?);
    let mut callback = |data: &DataMessage<'_>| visit(data);
    let mut parser = LogParser::default();
    parser.set_data_message_callback(&mut callback);
    match read_sections(&mut file, &mut parser).map_err(|e| failed(e.to_string()))? {
        Completeness::Complete => Ok(None),
        Completeness::Truncated => {
            Ok(Some(format!("{} ends in the middle: the logger lost power or was stopped", path.display())))
        }
        Completeness::MalformedRecord(reason) => {
            Ok(Some(format!("{} is damaged and was read up to that point: {reason}", path.display())))
        }
    }
}

fn topic_name(message: &DataMessage<'_>) -> String {
    let name = &message.flattened_format.message_name;
    match message.multi_id.value() {
        0 => name.clone(),
        instance => format!("{name}.{instance}"),
    }
}

/// Time of a sample, ns; the format stores microseconds.
fn time_ns(message: &DataMessage<'_>) -> Option<u64> {
    let offset = message.flattened_format.timestamp_field.as_ref()?.offset;
    Some(unsigned::<8>(message.data.get(offset.into()..)?)?.saturating_mul(1000))
}

/// Whether a field is a signal: texts are not, and the time field is the time axis.
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
