//! What a log of many topics offers, each on a clock of its own: ULog, DataFlash, blackbox.

use std::collections::BTreeMap;

use crate::mapping::Source;

/// What a log of many topics offers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Topics {
    /// Topics by name.
    pub by_name: BTreeMap<String, TopicSamples>,
    /// Sentences on what a reader should know: how the file ends when not as a finished one does, damage, a choice.
    pub remarks: Vec<String>,
}

/// A topic of a log.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TopicSamples {
    /// Its signals, with the units that the log states.
    pub signals: Vec<Source>,
    /// Times of its samples, ns.
    pub times_ns: Vec<u64>,
}

impl Topics {
    /// All signals, topic by topic.
    pub(crate) fn sources(&self) -> Vec<Source> {
        self.by_name.values().flat_map(|topic| topic.signals.iter().cloned()).collect()
    }
}
