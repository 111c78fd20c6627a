//! Summary of the contents of a log, without its samples.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use whirlstand_msgs::{Disturbance, Health, Message, Progress};

use crate::bench_info::BenchInfo;
use crate::blackbox::blackbox_topics;
use crate::csv_file::read_csv;
use crate::dataflash::dataflash_topics;
use crate::diff::remarks;
use crate::fields::sequence;
use crate::foreign::{Catalogue, catalogue};
use crate::log::Log;
use crate::log_file::{Damage, Ending};
use crate::panels::is_made_of_others;
use crate::read::{AnyReadError, Kind, kind};
use crate::record::Record;
use crate::sampling::{Gap, Sampling};
use crate::segments::missing_files;
use crate::topics::Topics;
use crate::ulog::ulog_topics;
use crate::wall_clock::carries_wall_clock;

/// Summary of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogInfo {
    /// Schema of this structure as JSON.
    pub schema: &'static str,
    /// The log.
    pub path: PathBuf,
    /// `mcap`, `ulog`, `dataflash`, `blackbox` or `csv`.
    pub kind: &'static str,
    /// Time from the first sample to the last, s (samples for a record without a known clock).
    pub duration: f64,
    /// The files of an MCAP log.
    pub files: Vec<FileInfo>,
    /// The bench that recorded it.
    pub bench: Option<BenchInfo>,
    /// Files attached inside the log: name and size in bytes.
    pub attached: Vec<(String, u64)>,
    /// Topics of a log with many topics, by name.
    pub topics: Vec<TopicInfo>,
    /// Signals of any other log, in file order.
    pub signals: Vec<SignalSummary>,
    /// Sampling of the time axis of any other log.
    pub sampling: Option<Sampling>,
    /// Damaged parts that could not be read.
    pub damage: Vec<Damage>,
    /// Remarks for the user, such as on cut-off files and damage.
    pub remarks: Vec<String>,
}

/// A file of a log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct FileInfo {
    /// The file.
    pub path: PathBuf,
    /// Its size, bytes.
    pub bytes: u64,
    /// How it ends.
    pub ending: Ending,
}

/// A topic of a log of many topics.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TopicInfo {
    /// Its name.
    pub name: String,
    /// The type of its messages.
    pub message_type: String,
    /// Encoding of its messages, for example `cdr`.
    pub encoding: String,
    /// Number of messages.
    pub messages: u64,
    /// Time of the first message, s.
    pub from: f64,
    /// Time of the last message, s.
    pub to: f64,
    /// Messages per second, from the median interval.
    pub rate_hz: Option<f64>,
    /// Number of missing messages according to the sequence numbers.
    pub lost: u64,
    /// Number of intervals longer than 1.5 times the median one.
    pub gaps: usize,
    /// The longest of them.
    pub longest_gap: Option<Gap>,
    /// Signals of a topic of another program, with their names for `--map` and the units that the log states.
    pub signals: Vec<String>,
}

/// A signal of a CSV.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignalSummary {
    /// Its name.
    pub name: String,
    /// SI unit.
    pub unit: String,
    /// Points with a value.
    pub values: usize,
    /// Points without one.
    pub missing: usize,
    /// Least value.
    pub min: Option<f64>,
    /// Greatest value.
    pub max: Option<f64>,
    /// Mean.
    pub mean: Option<f64>,
    /// Standard deviation.
    pub std: Option<f64>,
}

/// Summarises a log of any known kind.
///
/// # Errors
/// [`AnyReadError`].
pub fn info(path: impl AsRef<Path>) -> Result<LogInfo, AnyReadError> {
    let path = path.as_ref();
    match kind(path).map_err(|source| AnyReadError::Io { path: path.into(), source })? {
        Kind::Mcap => mcap_info(path),
        Kind::Ulog => Ok(topics_info(path, "ulog", ulog_topics(path)?)),
        Kind::Dataflash => Ok(topics_info(path, "dataflash", dataflash_topics(path)?)),
        Kind::Blackbox => Ok(topics_info(path, "blackbox", blackbox_topics(path)?)),
        Kind::Csv => Ok(record_info(path, &read_csv(path, &[])?)),
    }
}

fn empty(path: &Path, kind: &'static str) -> LogInfo {
    LogInfo {
        schema: "whirlstand.log_info.v1",
        path: path.into(),
        kind,
        duration: 0.0,
        files: Vec::new(),
        bench: None,
        attached: Vec::new(),
        topics: Vec::new(),
        signals: Vec::new(),
        sampling: None,
        damage: Vec::new(),
        remarks: Vec::new(),
    }
}

/// A topic while its messages are counted.
#[derive(Default)]
struct Counting {
    message_type: String,
    encoding: String,
    times: Vec<u64>,
    last_sequence: Option<u64>,
    lost: u64,
}

fn mcap_info(path: &Path) -> Result<LogInfo, AnyReadError> {
    let log = Log::open(path)?;
    let mut stream = log.stream()?;
    let mut topics: BTreeMap<String, Counting> = BTreeMap::new();
    while let Some(message) = stream.next()? {
        if !topics.contains_key(&message.topic.name) {
            let counting = Counting {
                message_type: message.topic.schema_name.clone(),
                encoding: message.topic.message_encoding.clone(),
                ..Counting::default()
            };
            topics.insert(message.topic.name.clone(), counting);
        }
        if let Some(counting) = topics.get_mut(&message.topic.name) {
            let sequence = sequence(&message);
            // A restarted publisher counts from 0 again, which is no loss. The same holds where several
            // publishers share a topic, as all nodes share /health.
            if let Some(last) = counting.last_sequence
                && sequence > last + 1
                && !carries_wall_clock(&message.topic.name)
            {
                counting.lost += sequence - last - 1;
            }
            counting.last_sequence = Some(sequence);
            counting.times.push(message.log_time);
        }
    }
    let bounds = topics.values().flat_map(|t| t.times.iter()).fold(None, |bounds, t| match bounds {
        None => Some((*t, *t)),
        Some((from, to)) => Some((t.min(&from).to_owned(), t.max(&to).to_owned())),
    });
    let mut offered: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut all = joined(path, stream.endings().len());
    all.extend(remarks(&stream));
    if log.info().is_none() {
        let Catalogue { signals, unreadable } = catalogue(&log)?;
        for signal in signals {
            // The name of a topic contains no dot, so the first dot begins the field.
            let topic = signal.split('.').next().unwrap_or("").to_string();
            offered.entry(topic).or_default().push(signal);
        }
        all.extend(unreadable.into_iter().map(|reason| format!("cannot be read: {reason}")));
    }
    let files = stream.endings().iter().map(|(path, ending)| FileInfo {
        path: path.clone(),
        bytes: std::fs::metadata(path).map_or(0, |m| m.len()),
        ending: *ending,
    });
    Ok(LogInfo {
        duration: bounds.map_or(0.0, |(from, to): (u64, u64)| (to - from) as f64 / 1e9),
        files: files.collect(),
        bench: log.info().cloned(),
        attached: stream.attached().iter().map(|f| (f.name.clone(), f.data.len() as u64)).collect(),
        topics: topics
            .into_iter()
            .map(|(name, counting)| TopicInfo {
                signals: offered.remove(&name).unwrap_or_default(),
                ..counting.result(name)
            })
            .collect(),
        damage: stream.damage().to_vec(),
        remarks: all,
        ..empty(path, "mcap")
    })
}

/// Remarks that several files form one log, and on missing files.
fn joined(path: &Path, files: usize) -> Vec<String> {
    let one = (files > 1).then(|| format!("{files} files are read in order as one log"));
    let missing =
        missing_files(path).into_iter().map(|file| format!("{} is missing between them", file.display()));
    one.into_iter().chain(missing).collect()
}

/// Types of the bench whose messages have no rate.
const IRREGULAR: [&str; 3] = [Health::TYPE_NAME, Disturbance::TYPE_NAME, Progress::TYPE_NAME];

impl Counting {
    fn result(mut self, name: String) -> TopicInfo {
        self.times.sort_unstable();
        let seconds: Vec<f64> = self.times.iter().map(|ns| *ns as f64 / 1e9).collect();
        // Messages of several nodes, or about changes, come at irregular times; a pause in them is no gap.
        let irregular =
            IRREGULAR.contains(&self.message_type.as_str()) || is_made_of_others(&name, &self.message_type);
        let sampling = Sampling::of(if irregular { &[] } else { &seconds });
        TopicInfo {
            name,
            message_type: self.message_type,
            encoding: self.encoding,
            messages: self.times.len() as u64,
            from: seconds.first().copied().unwrap_or_default(),
            to: seconds.last().copied().unwrap_or_default(),
            rate_hz: sampling.rate().filter(|rate| rate.is_finite()),
            lost: self.lost,
            gaps: sampling.gaps.len(),
            longest_gap: sampling.gaps.into_iter().max_by(|a, b| (a.to - a.from).total_cmp(&(b.to - b.from))),
            signals: Vec::new(),
        }
    }
}

/// Summary of a log with many topics; `kind` is also the encoding of its messages.
fn topics_info(path: &Path, kind: &'static str, log: Topics) -> LogInfo {
    let topics: Vec<TopicInfo> = log
        .by_name
        .into_iter()
        .map(|(name, topic)| {
            let counting = Counting { encoding: kind.into(), times: topic.times_ns, ..Counting::default() };
            let signals = topic.signals.into_iter().map(|source| match source.unit {
                Some(unit) => format!("{}[{unit}]", source.name),
                None => source.name,
            });
            TopicInfo { signals: signals.collect(), ..counting.result(name) }
        })
        .collect();
    let sampled = || topics.iter().filter(|t| t.messages > 0);
    let from = sampled().map(|t| t.from).fold(f64::INFINITY, f64::min);
    let to = sampled().map(|t| t.to).fold(f64::NEG_INFINITY, f64::max);
    LogInfo { duration: (to - from).max(0.0), topics, remarks: log.remarks, ..empty(path, kind) }
}

fn record_info(path: &Path, record: &Record) -> LogInfo {
    let signals = record.signals().iter().map(|signal| {
        let values: Vec<f64> = signal.values.iter().copied().filter(|v| !v.is_nan()).collect();
        let count = values.len() as f64;
        let mean = (!values.is_empty()).then(|| values.iter().sum::<f64>() / count);
        SignalSummary {
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            values: values.len(),
            missing: record.len() - values.len(),
            min: values.iter().copied().reduce(f64::min),
            max: values.iter().copied().reduce(f64::max),
            mean,
            std: mean.map(|m| (values.iter().map(|v| (v - m).powi(2)).sum::<f64>() / count).sqrt()),
        }
    });
    LogInfo {
        duration: record.duration(),
        signals: signals.collect(),
        sampling: Some(Sampling::of(&record.time)),
        remarks: record
            .unreadable()
            .iter()
            .map(|u| format!("left out: {u}"))
            .chain(record.left_out_rows().remarks())
            .collect(),
        ..empty(path, "csv")
    }
}
