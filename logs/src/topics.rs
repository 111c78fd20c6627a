//! The topics of a log with many topics, each with its own clock: ULog, DataFlash, blackbox.

use std::collections::BTreeMap;

use crate::mapping::Source;

/// The topics of a log with many topics.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Topics {
    /// Topics by name.
    pub by_name: BTreeMap<String, TopicSamples>,
    /// Remarks for the user: an irregular end of the file, damage, a choice between logs.
    pub remarks: Vec<String>,
}

/// Signals and times of one topic.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TopicSamples {
    /// Signals of the topic, with the units that the log states.
    pub signals: Vec<Source>,
    /// Times of the topic's samples, ns.
    pub times_ns: Vec<u64>,
}

impl Topics {
    /// All signals, topic by topic.
    pub(crate) fn sources(&self) -> Vec<Source> {
        self.by_name.values().flat_map(|topic| topic.signals.iter().cloned()).collect()
    }
}
