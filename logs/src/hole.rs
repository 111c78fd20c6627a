//! A hole in a log: messages that could not be written for a time.

use std::collections::BTreeMap;
use std::fmt;

use serde::Serialize;

/// Messages that are missing in a log, described at the beginning of the file that was written next.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Hole {
    /// Bench time of the last message before the hole, ns.
    pub from_ns: u64,
    /// Bench time at which the log continues, ns.
    pub until_ns: u64,
    /// Upper bound on the number of missing messages.
    pub messages: u64,
    /// Reason, for example `disk full`.
    pub reason: String,
}

impl Hole {
    /// Name of the metadata record.
    pub const METADATA_NAME: &str = "whirlstand.hole";

    /// The fields as texts of the metadata record.
    pub(crate) fn to_map(&self) -> BTreeMap<String, String> {
        BTreeMap::from([
            ("from_ns".into(), self.from_ns.to_string()),
            ("until_ns".into(), self.until_ns.to_string()),
            ("messages".into(), self.messages.to_string()),
            ("reason".into(), self.reason.clone()),
        ])
    }

    /// Reads the texts that [`Self::to_map`] wrote; an invalid number counts as 0.
    pub(crate) fn from_map(map: &BTreeMap<String, String>) -> Self {
        let number = |key: &str| map.get(key).and_then(|text| text.parse().ok()).unwrap_or(0);
        Self {
            from_ns: number("from_ns"),
            until_ns: number("until_ns"),
            messages: number("messages"),
            reason: map.get("reason").cloned().unwrap_or_default(),
        }
    }
}

impl fmt::Display for Hole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let s = |ns: u64| ns as f64 * 1e-9;
        write!(
            f,
            "the log has a gap from {:.3} s to {:.3} s: up to {} messages could not be written ({})",
            s(self.from_ns),
            s(self.until_ns),
            self.messages,
            self.reason
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_reads_back_and_says_what_it_is() {
        let hole = Hole {
            from_ns: 1_500_000_000,
            until_ns: 2_000_000_000,
            messages: 700,
            reason: "disk full".into(),
        };
        assert_eq!(Hole::from_map(&hole.to_map()), hole);
        assert_eq!(
            hole.to_string(),
            "the log has a gap from 1.500 s to 2.000 s: up to 700 messages could not be written (disk full)"
        );
    }
}
