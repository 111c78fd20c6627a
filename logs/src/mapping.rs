//! `--map roll=NAME[unit]`: assigns a signal of a foreign log to a signal of the vehicle.

use std::str::FromStr;

use serde::Serialize;
use whirlstand_msgs::units::{Unit, UnitError};

use whirlstand_msgs::names::did_you_mean;

/// One renaming: `source` of the log becomes the vehicle's `name`.
///
/// It is written `name=SOURCE`, `name=SOURCE[unit]` when the log states no unit or a wrong one, and
/// `name=-SOURCE` when the log has the opposite sign. SOURCE is a column of a CSV, `/topic.field.path` of an MCAP
/// log, or `topic.field` of a ULog, a DataFlash or a blackbox log. `t=SOURCE[ms]` names the time column of a CSV.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapping {
    /// Name of the signal in the vehicle.
    pub name: String,
    /// Name of the signal in the log, with the unit if one was written.
    source: String,
    /// Whether the log has the opposite sign.
    negated: bool,
}

/// A signal in a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// Name of the signal in the log.
    pub name: String,
    /// Unit that the log states, if any.
    pub unit: Option<String>,
}

impl Source {
    /// A signal of a log that states no units.
    pub(crate) fn without_unit(name: String) -> Self {
        Self { name, unit: None }
    }
}

/// Most names that a message lists.
const LISTED: usize = 60;

/// A list `a, b, c`, or `nothing`; a long list is cut.
pub(crate) fn list(names: &[String]) -> String {
    match names.len() {
        0 => "nothing".into(),
        n if n > LISTED => format!("{} and {} more", names[..LISTED].join(", "), n - LISTED),
        _ => names.join(", "),
    }
}

/// A mapping names a source that the log does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{origin} has no signal '{source_name}' to map to '{name}'{}. It has: {}",
    did_you_mean(source_name, available.iter().map(String::as_str)),
    list(available)
)]
pub struct MissingSource {
    /// The log.
    pub origin: String,
    /// Name of the signal in the vehicle.
    pub name: String,
    /// Name of the signal in the log.
    pub source_name: String,
    /// Signals that the log has.
    pub available: Vec<String>,
}

/// The reason why a mapping cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MapError {
    /// The text is not a mapping.
    #[error("'{text}' is not a mapping: write NAME=SOURCE or NAME=SOURCE[unit], as in roll=phi[deg]")]
    Syntax {
        /// The text.
        text: String,
    },
    /// The log does not have the source.
    #[error(transparent)]
    Missing(Box<MissingSource>),
    /// Two mappings have the same name.
    #[error("'{name}' is mapped twice: keep one of the two")]
    Twice {
        /// Name of the signal in the vehicle.
        name: String,
    },
    /// A unit cannot be read.
    #[error("signal '{name}' of {origin}: {source}")]
    Unit {
        /// The log.
        origin: String,
        /// Name of the signal in the log.
        name: String,
        /// The error in the unit.
        source: UnitError,
    },
}

/// A signal of a record that cannot be read, because of an unknown unit or of text among the numbers. It causes an
/// error only when it is requested.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, thiserror::Error)]
#[error("{why}")]
pub struct Unreadable {
    /// Its name.
    pub name: String,
    /// A sentence that names the file, the line or the signal.
    pub why: String,
}

/// A selected source with its name in the record and its conversion.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Selected {
    /// Index into the sources.
    pub source: usize,
    /// Name in the record.
    pub name: String,
    /// Unit of the source.
    pub unit: Unit,
    /// Whether the source has the opposite sign.
    pub negated: bool,
}

impl Selected {
    /// Converts a value of the source to SI.
    pub fn convert(&self, value: f64) -> f64 {
        let si = self.unit.to_si(value);
        if self.negated { -si } else { si }
    }
}

impl FromStr for Mapping {
    type Err = MapError;

    fn from_str(text: &str) -> Result<Self, MapError> {
        let syntax = || MapError::Syntax { text: text.into() };
        let (name, source) = text.split_once('=').ok_or_else(syntax)?;
        let (name, source) = (name.trim(), source.trim());
        let (negated, source) = match source.strip_prefix('-') {
            Some(rest) => (true, rest.trim_start()),
            None => (false, source),
        };
        if name.is_empty() || source.is_empty() || name.contains(['[', ']']) {
            return Err(syntax());
        }
        Ok(Self { name: name.into(), source: source.into(), negated })
    }
}

/// Splits `name[unit]`, or `name (unit)` as test stands and spreadsheets write it. Digits in square brackets are an index, not
/// a unit; what is no known unit in round ones is a part of the name.
pub fn split_unit(text: &str) -> (&str, Option<&str>) {
    let split = || {
        let (name, unit) = text.strip_suffix(']')?.rsplit_once('[')?;
        let index = !unit.is_empty() && unit.bytes().all(|b| b.is_ascii_digit());
        (!index && !name.is_empty()).then(|| (name.trim_end(), unit.trim()))
    };
    let in_round_brackets = || {
        let (name, unit) = text.strip_suffix(')')?.rsplit_once('(')?;
        let known = !unit.trim().is_empty() && unit.parse::<Unit>().is_ok();
        (known && !name.trim().is_empty()).then(|| (name.trim_end(), unit.trim()))
    };
    split().or_else(in_round_brackets).map_or((text, None), |(name, unit)| (name, Some(unit)))
}

impl Mapping {
    /// Whether the mapping refers to this source, with or without a unit.
    pub(crate) fn names(&self, source: &str) -> bool {
        self.source == source || split_unit(&self.source).0 == source
    }

    /// The source's index and the unit that the mapping states.
    fn find<'a>(&'a self, sources: &[Source], origin: &str) -> Result<(usize, Option<&'a str>), MapError> {
        let position = |name: &str| sources.iter().position(|s| s.name == name);
        let (bare, unit) = match self.source.strip_suffix("[1]") {
            // The digits are a unit, the pure number, unless the source has such an element.
            Some(bare) if position(&self.source).is_none() => (bare, Some("1")),
            _ => split_unit(&self.source),
        };
        if let Some(index) = position(&self.source) {
            return Ok((index, None));
        }
        position(bare).map(|index| (index, unit)).ok_or_else(|| {
            MapError::Missing(Box::new(MissingSource {
                origin: origin.into(),
                name: self.name.clone(),
                source_name: bare.into(),
                available: sources.iter().map(|s| s.name.clone()).collect(),
            }))
        })
    }
}

/// Selects the signals of a record: every mapped source under its new name; then, with `keep_others`, all
/// sources that no mapping refers to and whose name is free. Also returns the selected signals whose unit
/// cannot be read.
pub(crate) fn resolve(
    sources: &[Source],
    mappings: &[Mapping],
    keep_others: bool,
    origin: &str,
) -> Result<(Vec<Selected>, Vec<Unreadable>), MapError> {
    let unit_of = |index: usize, stated: Option<&str>| {
        let text = stated.or(sources[index].unit.as_deref()).unwrap_or("");
        text.parse().map_err(|source| MapError::Unit {
            origin: origin.into(),
            name: sources[index].name.clone(),
            source,
        })
    };
    let mut selected: Vec<Selected> = Vec::new();
    let mut unreadable = Vec::new();
    let mut mapped = vec![false; sources.len()];
    for m in mappings {
        if selected.iter().any(|s| s.name == m.name) {
            return Err(MapError::Twice { name: m.name.clone() });
        }
        let (source, stated) = m.find(sources, origin)?;
        mapped[source] = true;
        let unit = unit_of(source, stated)?;
        selected.push(Selected { source, name: m.name.clone(), unit, negated: m.negated });
    }
    if keep_others {
        for (source, offered) in sources.iter().enumerate() {
            if !mapped[source] && !selected.iter().any(|s| s.name == offered.name) {
                let name = offered.name.clone();
                match unit_of(source, None) {
                    Ok(unit) => selected.push(Selected { source, name, unit, negated: false }),
                    Err(error) => unreadable.push(Unreadable {
                        why: format!("{error}; --map {name}={name}[unit] sets a different one"),
                        name,
                    }),
                }
            }
        }
    }
    Ok((selected, unreadable))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources() -> Vec<Source> {
        [("phi", None), ("p", Some("deg/s")), ("/att.q[0]", None), ("roll", Some("rad"))]
            .map(|(name, unit)| Source { name: name.into(), unit: unit.map(str::to_string) })
            .to_vec()
    }

    fn resolved(texts: &[&str]) -> Result<Vec<Selected>, MapError> {
        let mappings = texts.iter().map(|t| t.parse()).collect::<Result<Vec<_>, _>>()?;
        resolve(&sources(), &mappings, true, "x.csv").map(|(selected, _)| selected)
    }

    #[test]
    fn mapped_signals_come_first_and_the_rest_keeps_its_name() {
        let all = resolved(&["roll=phi[deg]", "roll_rate=-p", "w=/att.q[0]"]).unwrap();
        let names: Vec<_> = all.iter().map(|s| (s.name.as_str(), s.source)).collect();
        // A mapped signal replaces the log's own 'roll'.
        assert_eq!(names, [("roll", 0), ("roll_rate", 1), ("w", 2)]);
        assert_eq!(all[0].convert(180.0), std::f64::consts::PI);
        assert_eq!(all[1].convert(180.0), -std::f64::consts::PI);
        assert_eq!(all[2].convert(0.5), 0.5);
        assert_eq!(resolved(&[]).unwrap().len(), 4);
    }

    #[test]
    fn one_source_can_be_two_signals_and_brackets_with_digits_are_an_index() {
        let all = resolved(&["a=phi[1]", "b=phi[deg]"]).unwrap();
        assert_eq!((all[0].source, all[1].source), (0, 0));
        assert!(all[0].unit.is_si() && !all[1].unit.is_si());
        assert!(matches!(resolved(&["a=/att.q[1]"]), Err(MapError::Missing(_))));
        assert_eq!(split_unit("q[2]"), ("q[2]", None));
        assert_eq!(split_unit("Motor Optical Speed (rad/s)"), ("Motor Optical Speed", Some("rad/s")));
        assert_eq!(split_unit("acc x (IMU)"), ("acc x (IMU)", None));
        assert_eq!(split_unit("q[2][deg]"), ("q[2]", Some("deg")));
    }

    #[test]
    fn errors_name_what_is_wrong() {
        for text in ["roll", "=phi", "roll=", "roll=-", "r[1]=phi"] {
            assert!(matches!(text.parse::<Mapping>(), Err(MapError::Syntax { .. })), "{text}");
        }
        let error = resolved(&["roll=phy"]).unwrap_err().to_string();
        assert_eq!(
            error,
            "x.csv has no signal 'phy' to map to 'roll' (did you mean 'phi'?). It has: phi, p, /att.q[0], roll"
        );
        assert!(matches!(resolved(&["a=phi", "a=p"]), Err(MapError::Twice { .. })));
        assert!(matches!(resolved(&["a=phi[bogus]"]), Err(MapError::Unit { .. })));
    }
}
