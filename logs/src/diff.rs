//! Bitwise comparison of two logs.
//!
//! Topics are compared one by one, message by message in the order in which each topic was recorded: the
//! interleaving of messages of different topics depends on scheduling, their contents do not. Topics that carry
//! wall-clock time (`/health`, `/progress`) are excluded, and so are those that the recorder derived from others
//! (`/tf`, `/scene`, `/log`). Both logs are read side by side; only messages whose counterpart in the other log
//! has not been read yet are kept in memory.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::path::{Path, PathBuf};

use crate::fields::{first_difference, step};
use crate::log::Log;
use crate::log_file::{Damage, Ending};
use crate::panels::is_made_of_others;
use crate::read_error::ReadError;
use crate::stream::LogStream;
use crate::wall_clock::carries_wall_clock;
use crate::writer::CDR_HEADER;
use serde::Serialize;

/// Result of the comparison of two logs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Diff {
    /// Schema of this structure as JSON.
    pub schema: &'static str,
    /// The first log.
    pub a: PathBuf,
    /// The second log.
    pub b: PathBuf,
    /// Whether every message of every compared topic is the same, bit for bit.
    pub identical: bool,
    /// The earliest difference over all topics.
    pub first: Option<Difference>,
    /// Topics in alphabetical order.
    pub topics: Vec<TopicDiff>,
    /// Differences in the descriptions of the benches. They alone do not make the logs different.
    pub benches: Vec<BenchDifference>,
    /// Remarks on logs without a regular end or with damage; the rest is compared.
    pub remarks: Vec<String>,
}

/// One topic in both logs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TopicDiff {
    /// Its name.
    pub topic: String,
    /// Whether the topic is not compared, because it carries wall-clock time or was derived from other
    /// topics.
    pub set_aside: bool,
    /// Whether the topic was derived from other topics.
    pub is_made_of_others: bool,
    /// Messages in the first log.
    pub messages_a: u64,
    /// Messages in the second log.
    pub messages_b: u64,
    /// Number of pairs of equal messages.
    pub equal: u64,
    /// The first difference of the topic.
    pub first: Option<Difference>,
}

/// A message that differs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// Topic of the message.
    pub topic: String,
    /// Index of the message within the topic.
    pub index: u64,
    /// Step of the message where its type is known; that of the first log if the two differ.
    pub step: Option<u64>,
    /// Time of the message on the log's axis, ns.
    pub log_time_ns: u64,
    /// The first field that differs; `message` when one log has no such message, `schema` when the types differ.
    pub field: String,
    /// Value in the first log.
    pub a: String,
    /// Value in the second log.
    pub b: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, ", self.topic)?;
        if let Some(step) = self.step {
            write!(f, "step {step}, ")?;
        }
        write!(
            f,
            "message {} of the topic: {} is {} in A and {} in B",
            self.index, self.field, self.a, self.b
        )
    }
}

/// A difference in the descriptions of two benches.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BenchDifference {
    /// Key of the entry, for example `seed`.
    pub key: String,
    /// Value in the first log.
    pub a: String,
    /// Value in the second log.
    pub b: String,
}

/// A message whose counterpart has not been read yet.
struct Waiting {
    log_time: u64,
    data: Vec<u8>,
}

/// Comparison of one topic while both logs are read.
#[derive(Default)]
struct Pairing {
    set_aside: bool,
    is_made_of_others: bool,
    counts: [u64; 2],
    types: [Option<(String, Vec<u8>)>; 2],
    waiting: [VecDeque<Waiting>; 2],
    equal: u64,
    first: Option<Difference>,
}

/// One of the two logs.
struct Side {
    stream: LogStream,
    /// Time of the last message read, ns; the log with the earlier time is read next.
    at: u64,
    ended: bool,
}

/// Compares two logs.
///
/// # Errors
/// [`ReadError`] when one of them cannot be opened or read.
pub fn diff(a: impl AsRef<Path>, b: impl AsRef<Path>) -> Result<Diff, ReadError> {
    let (a, b) = (a.as_ref(), b.as_ref());
    let benches = benches(&Log::open(a)?, &Log::open(b)?);
    let side = |path| Ok(Side { stream: LogStream::open(path)?, at: 0, ended: false });
    let mut sides: [Side; 2] = [side(a)?, side(b)?];
    let mut topics: BTreeMap<String, Pairing> = BTreeMap::new();
    while !(sides[0].ended && sides[1].ended) {
        let which = match (sides[0].ended, sides[1].ended) {
            (true, _) => 1,
            (_, true) => 0,
            _ => usize::from(sides[1].at < sides[0].at),
        };
        read_one(&mut sides[which], which, &mut topics)?;
    }
    for (name, pairing) in &mut topics {
        pairing.finish(name);
    }
    let topics: Vec<TopicDiff> = topics.into_iter().map(|(name, pairing)| pairing.result(name)).collect();
    let first =
        topics.iter().filter_map(|t| t.first.clone()).min_by_key(|d| (d.log_time_ns, d.topic.clone()));
    Ok(Diff {
        schema: "whirlstand.log_diff.v1",
        a: a.into(),
        b: b.into(),
        identical: first.is_none(),
        first,
        topics,
        benches,
        remarks: sides.iter().flat_map(|s| remarks(&s.stream)).collect(),
    })
}

fn read_one(side: &mut Side, which: usize, topics: &mut BTreeMap<String, Pairing>) -> Result<(), ReadError> {
    let Some(message) = side.stream.next()? else {
        side.ended = true;
        return Ok(());
    };
    side.at = message.log_time;
    let name = message.topic.name.as_str();
    if !topics.contains_key(name) {
        let is_made_of_others = is_made_of_others(name, &message.topic.schema_name);
        let set_aside = is_made_of_others || carries_wall_clock(name);
        topics.insert(name.to_string(), Pairing { set_aside, is_made_of_others, ..Pairing::default() });
    }
    let Some(pairing) = topics.get_mut(name) else { return Ok(()) };
    if pairing.types[which].is_none() {
        let topic = message.topic;
        pairing.types[which] = Some((topic.schema_name.clone(), topic.layout.clone()));
    }
    pairing.take(which, name, message.log_time, message.data);
    Ok(())
}

impl Pairing {
    fn take(&mut self, which: usize, name: &str, log_time: u64, data: &[u8]) {
        self.counts[which] += 1;
        if self.set_aside {
            return;
        }
        let Some(other) = self.waiting[1 - which].pop_front() else {
            self.waiting[which].push_back(Waiting { log_time, data: data.to_vec() });
            return;
        };
        if self.types[0] == self.types[1] && other.data == data {
            self.equal += 1;
            return;
        }
        if self.first.is_some() {
            return;
        }
        let (a, b) = if which == 0 { (data, other.data.as_slice()) } else { (other.data.as_slice(), data) };
        let type_of = |i: usize| self.types[i].as_ref().map_or("", |t| t.0.as_str());
        let (field, a_text, b_text) = if self.types[0] == self.types[1] {
            first_difference(type_of(0), body(a), body(b))
        } else {
            ("schema".into(), type_of(0).into(), type_of(1).into())
        };
        self.first = Some(Difference {
            topic: name.into(),
            index: self.counts[which] - 1,
            step: step(type_of(0), body(a)),
            log_time_ns: log_time.min(other.log_time),
            field,
            a: a_text,
            b: b_text,
        });
    }

    /// After the end of both logs, the waiting messages have no counterpart.
    fn finish(&mut self, name: &str) {
        let which = usize::from(self.waiting[0].is_empty());
        let Some(extra) = self.waiting[which].front() else { return };
        if self.first.is_some() {
            return;
        }
        let type_name = self.types[which].as_ref().map_or("", |t| t.0.as_str());
        let text = |i: usize| if i == which { "there".to_string() } else { "missing".to_string() };
        self.first = Some(Difference {
            topic: name.into(),
            index: self.counts[1 - which],
            step: step(type_name, body(&extra.data)),
            log_time_ns: extra.log_time,
            field: "message".into(),
            a: text(0),
            b: text(1),
        });
    }

    fn result(self, topic: String) -> TopicDiff {
        let [messages_a, messages_b] = self.counts;
        TopicDiff {
            topic,
            set_aside: self.set_aside,
            is_made_of_others: self.is_made_of_others,
            messages_a,
            messages_b,
            equal: self.equal,
            first: self.first,
        }
    }
}

fn body(data: &[u8]) -> &[u8] {
    data.strip_prefix(&CDR_HEADER).unwrap_or(data)
}

/// Differences in the descriptions of two benches, except for the time of day.
fn benches(a: &Log, b: &Log) -> Vec<BenchDifference> {
    let texts = |log: &Log| {
        let mut map = log.info().map(crate::BenchInfo::to_map).unwrap_or_default();
        map.remove("started_unix_ns");
        map
    };
    let (mut left, mut right) = (texts(a), texts(b));
    let keys: std::collections::BTreeSet<String> = left.keys().chain(right.keys()).cloned().collect();
    let mut all: Vec<BenchDifference> = keys
        .into_iter()
        .map(|key| {
            let (a, b) = (left.remove(&key).unwrap_or_default(), right.remove(&key).unwrap_or_default());
            BenchDifference { key, a, b }
        })
        .filter(|d| d.a != d.b)
        .collect();
    let bytes =
        |log: &Log, name: &str| log.attached().iter().find(|f| f.name == name).map(|f| f.data.clone());
    for name in [crate::bench_info::LAUNCH_ATTACHMENT, crate::bench_info::VEHICLE_ATTACHMENT] {
        let (in_a, in_b) = (bytes(a, name), bytes(b, name));
        if in_a != in_b {
            let size =
                |f: &Option<Vec<u8>>| f.as_ref().map_or("none".into(), |d| format!("{} bytes", d.len()));
            all.push(BenchDifference { key: name.into(), a: size(&in_a), b: size(&in_b) });
        }
    }
    all
}

/// Remarks on a log that is not complete.
pub(crate) fn remarks(stream: &LogStream) -> Vec<String> {
    let cut = stream.endings().iter().filter(|(_, ending)| *ending == Ending::Truncated).map(|(path, _)| {
        format!("{} is incomplete: its recorder was killed or is still running", path.display())
    });
    let damaged = stream.damage().iter().map(|Damage { file, offset, reason }| {
        format!("{} is damaged at byte {offset}: {reason}", file.display())
    });
    let holes = stream.holes().map(|hole| hole.to_string());
    cut.chain(damaged).chain(holes).collect()
}
