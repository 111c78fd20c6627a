//! A launch file as text with positions: values can be overridden one by one, and every error names its line.

use std::borrow::Cow;
use std::ops::Range;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::finite::not_finite;
use super::wording::reworded;

/// What is wrong in a launch file, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {message}")]
pub(crate) struct LaunchError {
    /// File and line, or the override that set the value.
    pub place: String,
    /// What is wrong, what was expected, what to do.
    pub message: String,
}

/// The text of a launch file with its overrides, and the place of every key and value.
#[derive(Debug, Clone)]
pub(crate) struct Document {
    /// Name of the file in messages.
    origin: String,
    text: String,
    /// A value that override i set has a span that starts at `text.len() + 1 + i`.
    overrides: Vec<Override>,
}

#[derive(Debug, Clone)]
struct Override {
    /// Name of the override in messages.
    label: String,
    /// `KEY = 0`: the key in a form that the TOML parser can split.
    key: String,
    /// `v = VALUE`.
    value: String,
}

/// One step of a path into the document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Step<'p> {
    /// Key of a table.
    Key(&'p str),
    /// Index into an array, from 0.
    Index(usize),
}

impl<'p> From<&'p str> for Step<'p> {
    fn from(key: &'p str) -> Self {
        Self::Key(key)
    }
}

impl<'p> From<&'p String> for Step<'p> {
    fn from(key: &'p String) -> Self {
        Self::Key(key)
    }
}

impl From<usize> for Step<'_> {
    fn from(index: usize) -> Self {
        Self::Index(index)
    }
}

/// Makes a path for [`Document::error_at`] from keys and indices.
macro_rules! at {
    ($($step:expr),* $(,)?) => { &[$($crate::file::document::Step::from($step)),*] };
}
pub(crate) use at;

impl Document {
    /// Parses the text of a launch file; `origin` is its name in messages.
    ///
    /// # Errors
    /// When the text is not TOML, with the line.
    pub fn parse(origin: &str, text: &str) -> Result<Self, LaunchError> {
        let document = Self { origin: origin.into(), text: text.into(), overrides: Vec::new() };
        DeTable::parse(text).map_err(|e| LaunchError {
            place: document.place(&e.span().unwrap_or(0..0)),
            message: format!("this is not valid TOML: {}", e.message()),
        })?;
        Ok(document)
    }

    /// The text as it was read, without overrides.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The overrides as they were given, in order.
    pub fn overrides(&self) -> Vec<&str> {
        self.overrides.iter().map(|o| o.label.as_str()).collect()
    }

    /// Applies `KEY=VALUE` as given to the option `option`, for example `--set`.
    ///
    /// The value is TOML; what is not TOML is taken as a string, so that `controller.law=lqr` needs no quotes.
    ///
    /// # Errors
    /// When there is no `=`, when the key is not a dotted key, or when it leads through something that is no table.
    pub fn set(&mut self, option: &str, assignment: &str) -> Result<(), LaunchError> {
        let label = format!("{option} {assignment}");
        let Some((key, value)) = assignment.split_once('=') else {
            return Err(LaunchError {
                place: label,
                message: "an assignment KEY=VALUE is expected, for example controller.law=lqr".into(),
            });
        };
        let written = format!("v = {}", value.trim());
        let value = match DeTable::parse(&written) {
            Ok(table) if table.get_ref().len() == 1 => written,
            _ => format!("v = {}", toml::Value::String(value.trim().into())),
        };
        self.push(Override { label, key: format!("{} = 0", key.trim()), value })
    }

    /// Applies one entry of a variant's `set` table; `label` is its name in messages.
    ///
    /// # Errors
    /// As [`Document::set`].
    pub fn set_value(&mut self, label: String, key: &str, value: &toml::Value) -> Result<(), LaunchError> {
        self.push(Override { label, key: format!("{key} = 0"), value: format!("v = {value}") })
    }

    fn push(&mut self, new: Override) -> Result<(), LaunchError> {
        let label = new.label.clone();
        self.overrides.push(new);
        self.table().map(|_| ()).map_err(|message| LaunchError { place: label, message })
    }

    /// The whole document with the overrides applied. The error is the message of the first override that
    /// does not apply.
    fn table(&self) -> Result<DeTable<'_>, String> {
        // The text was parsed when the document was made, so it parses.
        let table = DeTable::parse(&self.text).map_err(|e| e.message().to_string())?;
        let mut whole = Spanned::new(0..0, DeValue::Table(table.into_inner()));
        for (i, change) in self.overrides.iter().enumerate() {
            let at = self.text.len() + 1 + i;
            let steps = dotted(&change.key).ok_or_else(|| {
                "the key cannot be parsed: write names separated by dots, such as plant.initial.roll"
                    .to_string()
            })?;
            let value = DeTable::parse(&change.value).map_err(|e| e.message().to_string())?;
            let Some((_, mut value)) = value.into_inner().into_iter().next() else { continue };
            respan(&mut value, at);
            assign(&mut whole, &steps, value, at)?;
        }
        match whole.into_inner() {
            DeValue::Table(table) => Ok(table),
            _ => Err("a launch file is a table".into()),
        }
    }

    /// The document with its overrides, each of which was checked when it was added.
    fn checked(&self) -> Result<DeTable<'_>, LaunchError> {
        self.table().map_err(|message| LaunchError { place: self.origin.clone(), message })
    }

    /// Deserialises the document into its structure.
    ///
    /// # Errors
    /// For an unknown key, with the nearest known one; for a missing key or a value of the wrong type.
    pub fn read<T: DeserializeOwned>(&self) -> Result<T, LaunchError> {
        let table = self.checked()?;
        if let Some(span) = not_finite(&table) {
            return Err(LaunchError {
                place: self.place(&span),
                message: "a finite number is expected".into(),
            });
        }
        let table = Spanned::new(0..0, table);
        T::deserialize(toml::Deserializer::from(table)).map_err(|e| self.syntax_error(&e, 0..0))
    }

    /// Deserialises the part at `path`; `None` when that does not exist.
    ///
    /// # Errors
    /// As [`Document::read`].
    pub fn read_at<T: DeserializeOwned>(&self, path: &[Step<'_>]) -> Result<Option<T>, LaunchError> {
        let table = self.checked()?;
        let (span, found) = follow(&table, path);
        let Some(value) = found else { return Ok(None) };
        let read = T::deserialize(toml::de::ValueDeserializer::from(value.clone()));
        read.map(Some).map_err(|e| self.syntax_error(&e, span))
    }

    fn syntax_error(&self, error: &toml::de::Error, fallback: Range<usize>) -> LaunchError {
        LaunchError {
            place: self.place(&error.span().unwrap_or(fallback)),
            message: reworded(error.message()),
        }
    }

    /// An error about the value at `path`, or at the deepest part of it that exists.
    pub fn error_at(&self, path: &[Step<'_>], message: impl Into<String>) -> LaunchError {
        let place = match self.table() {
            Ok(table) => self.place(&follow(&table, path).0),
            Err(_) => self.origin.clone(),
        };
        LaunchError { place, message: message.into() }
    }

    fn place(&self, span: &Range<usize>) -> String {
        match span.start.checked_sub(self.text.len() + 1).and_then(|i| self.overrides.get(i)) {
            Some(change) => change.label.clone(),
            None => {
                let before = self.text.bytes().take(span.start);
                format!("{}, line {}", self.origin, before.filter(|&b| b == b'\n').count() + 1)
            }
        }
    }
}

/// The place of the deepest part of `path` that exists, and the value when all of it does.
fn follow<'t, 'd>(
    table: &'t DeTable<'d>,
    path: &[Step<'_>],
) -> (Range<usize>, Option<&'t Spanned<DeValue<'d>>>) {
    let mut span = 0..0;
    let mut value: Option<&Spanned<DeValue<'d>>> = None;
    for step in path {
        let table = match value {
            None => Some(table),
            Some(value) => value.get_ref().as_table(),
        };
        let found = match step {
            Step::Key(key) => {
                table.and_then(|t| t.iter().find(|(k, _)| k.get_ref() == key)).map(|(k, v)| (k.span(), v))
            }
            Step::Index(index) => value
                .and_then(|v| v.get_ref().as_array())
                .and_then(|array| array.get(*index))
                .map(|v| (v.span(), v)),
        };
        let Some((at, inner)) = found else { return (span, None) };
        span = at;
        value = Some(inner);
    }
    (span, value)
}

/// The names of a dotted key, from `KEY = 0`.
fn dotted(key: &str) -> Option<Vec<Cow<'_, str>>> {
    let mut table = DeTable::parse(key).ok()?.into_inner();
    let mut names = Vec::new();
    loop {
        let mut entries = table.into_iter();
        let (name, value) = entries.next()?;
        if entries.next().is_some() {
            return None;
        }
        names.push(name.into_inner());
        match value.into_inner() {
            DeValue::Table(inner) => table = inner,
            _ => return Some(names),
        }
    }
}

/// Gives a value and all of its contents the position `at`.
fn respan(value: &mut Spanned<DeValue<'_>>, at: usize) {
    let mut inner = std::mem::replace(value.get_mut(), DeValue::Boolean(false));
    match &mut inner {
        DeValue::Array(array) => array.iter_mut().for_each(|v| respan(v, at)),
        DeValue::Table(table) => {
            *table = std::mem::take(table)
                .into_iter()
                .map(|(key, mut v)| {
                    respan(&mut v, at);
                    (Spanned::new(at..at, key.into_inner()), v)
                })
                .collect();
        }
        _ => {}
    }
    *value = Spanned::new(at..at, inner);
}

/// Sets `value` at `steps`. Missing tables on the way are created; elements of arrays must exist.
fn assign<'d>(
    whole: &mut Spanned<DeValue<'d>>,
    steps: &[Cow<'d, str>],
    value: Spanned<DeValue<'d>>,
    at: usize,
) -> Result<(), String> {
    let Some((first, rest)) = steps.split_first() else {
        *whole = value;
        return Ok(());
    };
    match whole.get_mut() {
        DeValue::Table(table) => {
            let key = table.keys().find(|k| k.get_ref() == first).cloned();
            let key = key.unwrap_or_else(|| Spanned::new(at..at, first.clone()));
            let inner = table.remove(&key);
            // The key's own position changes with its value, so that an unknown key is reported for the
            // override.
            let key = if rest.is_empty() { Spanned::new(at..at, key.into_inner()) } else { key };
            let mut inner = inner.unwrap_or_else(|| Spanned::new(at..at, DeValue::Table(DeTable::new())));
            let result = assign(&mut inner, rest, value, at);
            table.insert(key, inner);
            result
        }
        DeValue::Array(array) => {
            let count = array.len();
            let chosen = first.parse::<usize>().ok().and_then(|i| array.get_mut(i));
            let chosen = chosen.ok_or_else(|| match count {
                0 => format!("there is no entry '{first}': the list is empty"),
                _ => format!("there is no entry '{first}': the list has the entries 0 to {}", count - 1),
            })?;
            assign(chosen, rest, value, at)
        }
        other => Err(format!("'{first}' cannot be set: the key before it is a {}", other.type_str())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        name: String,
        #[serde(default)]
        rate_hz: f64,
        #[serde(default)]
        steps: Vec<Change>,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Change {
        at_s: f64,
    }

    const TEXT: &str = "name = 'a'\n\n[[steps]]\nat_s = 1.0\n";

    #[test]
    fn overrides_reach_tables_and_arrays_and_bare_words_are_strings() {
        let mut document = Document::parse("a.toml", TEXT).unwrap();
        document.set("--set", "name=two words").unwrap();
        document.set("--set", "steps.0.at_s = 2").unwrap();
        document.set("--set", "rate_hz=1e3").unwrap();
        let file: File = document.read().unwrap();
        assert_eq!(
            (file.name.as_str(), file.rate_hz, file.steps),
            ("two words", 1e3, vec![Change { at_s: 2.0 }])
        );
    }

    #[test]
    fn errors_name_the_line_or_the_override() {
        let document = Document::parse("a.toml", "name = 'a'\n\nrate_hzz = 3\n").unwrap();
        let error = document.read::<File>().unwrap_err();
        assert_eq!(error.place, "a.toml, line 3");
        assert!(error.message.contains("rate_hzz") && error.message.contains("'rate_hz'"), "{error}");

        let mut document = Document::parse("a.toml", TEXT).unwrap();
        document.set("--set", "steps.0.at_m=2").unwrap();
        let error = document.read::<File>().unwrap_err();
        assert_eq!(error.place, "--set steps.0.at_m=2");
        assert_eq!(document.error_at(at!["steps", 0, "at_s"], "x").place, "a.toml, line 4");
        assert_eq!(document.error_at(at!["steps", 7, "at_s"], "x").place, "a.toml, line 3");
    }

    #[test]
    fn overrides_that_lead_nowhere_are_refused() {
        let mut document = Document::parse("a.toml", TEXT).unwrap();
        for (assignment, words) in [
            ("name", "KEY=VALUE"),
            ("steps.3.at_s=1", "0 to 0"),
            ("name.x=1", "string"),
            ("a b=1", "the key cannot be parsed"),
        ] {
            let error = document.clone().set("--set", assignment).unwrap_err();
            assert!(error.message.contains(words), "{assignment}: {error}");
        }
        document.set("--set", "rate_hz=\"fast\"").unwrap();
        assert!(document.read::<File>().unwrap_err().to_string().contains("\"fast\""));
    }

    #[test]
    fn what_is_no_toml_is_told_with_its_line() {
        let error = Document::parse("a.toml", "name = 'a'\nrate_hz = = 2\n").unwrap_err();
        assert_eq!(error.place, "a.toml, line 2");
    }
}
