//! Parts of many flights or trials: the assignment of numbers to parts, and the check for completeness.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

/// A part of a campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    /// Number of the part, from 1.
    pub part: u64,
    /// Number of parts.
    pub of: u64,
}

/// The reason why parts do not make a whole.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PartsError {
    /// No part at all.
    #[error("no part is given")]
    None,
    /// Parts of different wholes.
    #[error("{path} does not match the first part: {what} differs")]
    Mixed {
        /// The file.
        path: String,
        /// What differs.
        what: &'static str,
    },
    /// Not all parts.
    #[error("parts {0} are missing")]
    Missing(String),
    /// The same part twice.
    #[error("{path} is part {part}, which was already given")]
    Twice {
        /// The file.
        path: String,
        /// The part.
        part: Shard,
    },
}

impl Shard {
    /// The only part of an undivided whole.
    const WHOLE: Self = Self { part: 1, of: 1 };

    /// Whether the flight of this number belongs to the part.
    pub fn has(self, flight: u64) -> bool {
        flight % self.of == self.part - 1
    }

    /// Checks that the parts in these files make one whole; `None` stands for a file that is not a part.
    ///
    /// # Errors
    /// When a part is missing, duplicate, or one of another number of parts.
    pub fn check_whole(parts: &[(&str, Option<Self>)]) -> Result<(), PartsError> {
        let of = parts.first().ok_or(PartsError::None)?.1.unwrap_or(Self::WHOLE).of;
        let mut seen = BTreeSet::new();
        for (path, part) in parts {
            let (path, part) = ((*path).to_string(), part.unwrap_or(Self::WHOLE));
            if part.of != of {
                return Err(PartsError::Mixed { path, what: "the number of parts" });
            }
            if !seen.insert(part) {
                return Err(PartsError::Twice { path, part });
            }
        }
        let missing = (1..=of).map(|part| Self { part, of }).filter(|part| !seen.contains(part));
        let missing: Vec<String> = missing.map(|part| part.to_string()).collect();
        if missing.is_empty() { Ok(()) } else { Err(PartsError::Missing(missing.join(", "))) }
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers =
            text.split_once('/').and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)));
        match numbers {
            Some((part, of)) if (1..=of).contains(&part) => Ok(Self { part, of }),
            _ => Err("K/N is expected, the part K of N, for example 2/8".into()),
        }
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.part, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_make_a_whole_when_each_is_there_once() {
        let of = |parts: &[&str]| {
            let parts: Vec<_> = parts.iter().map(|part| (*part, part.parse().ok())).collect();
            Shard::check_whole(&parts)
        };
        assert_eq!((of(&["2/3", "1/3", "3/3"]), of(&["whole"]), of(&["1/1"])), (Ok(()), Ok(()), Ok(())));
        assert_eq!(of(&["3/4", "1/4"]), Err(PartsError::Missing("2/4, 4/4".into())));
        assert_eq!(of(&[]), Err(PartsError::None));
        let twice = |path: &str, part| Err(PartsError::Twice { path: path.into(), part });
        assert_eq!(of(&["1/2", "2/2", "1/2"]), twice("1/2", Shard { part: 1, of: 2 }));
        assert_eq!(of(&["whole", "whole"]), twice("whole", Shard::WHOLE));
        assert!(matches!(of(&["1/2", "2/3"]), Err(PartsError::Mixed { .. })));
    }
}
