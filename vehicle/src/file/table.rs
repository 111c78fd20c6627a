//! A TOML document in which every node has its location, so that an error can name line and field.

use toml::Spanned;
use toml::de::{DeTable, DeValue};
use whirlstand_msgs::units::{Quantity, Unit};

use whirlstand_msgs::names::did_you_mean;

use crate::error::{FileError, list};
use crate::signal_unit::SignalUnit;

/// The text that contains a node.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    pub file: &'a str,
    pub text: &'a str,
}

impl Source<'_> {
    /// An error at a byte offset.
    pub fn error(&self, offset: Option<usize>, field: &str, reason: impl Into<String>) -> FileError {
        let line = offset.map(|o| {
            1 + self.text.as_bytes()[..o.min(self.text.len())].iter().filter(|b| **b == b'\n').count()
        });
        FileError { file: self.file.into(), line, field: field.into(), reason: reason.into() }
    }
}

/// A value in the document.
#[derive(Clone)]
pub struct Node<'a> {
    source: Source<'a>,
    value: &'a DeValue<'a>,
    offset: usize,
    path: String,
}

/// A table with checked keys.
pub struct Table<'a> {
    source: Source<'a>,
    entries: &'a DeTable<'a>,
    offset: usize,
    path: String,
}

impl<'a> Node<'a> {
    fn new(source: Source<'a>, value: &'a Spanned<DeValue<'a>>, path: String) -> Self {
        Self { source, value: value.get_ref(), offset: value.span().start, path }
    }

    pub fn error(&self, reason: impl Into<String>) -> FileError {
        self.source.error(Some(self.offset), &self.path, reason)
    }

    fn expected(&self, what: &str) -> FileError {
        self.error(format!(
            "expected {what}, found {} {}",
            article(self.value.type_str()),
            self.value.type_str()
        ))
    }

    pub fn text(&self) -> Result<&'a str, FileError> {
        self.value.as_str().ok_or_else(|| self.expected("a string in quotes"))
    }

    /// A valid name: not empty, without the characters that have a meaning in an effect's `where`.
    pub fn name(&self) -> Result<String, FileError> {
        let name = self.text()?;
        let valid = |c: char| c.is_alphanumeric() || c == '_' || c == '-' || c == '.';
        if name.is_empty() || !name.chars().all(valid) {
            return Err(self.error(format!("'{name}' is not a name: use letters, digits, '_', '-' and '.'")));
        }
        Ok(name.into())
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64, FileError> {
        let value = match self.value {
            DeValue::Float(f) => f.as_str().replace('_', "").parse().ok(),
            DeValue::Integer(i) => {
                i64::from_str_radix(&i.as_str().replace('_', ""), i.radix()).ok().map(|i| i as f64)
            }
            _ => return Err(self.expected("a number")),
        };
        let value: f64 = value.ok_or_else(|| self.expected("a number"))?;
        if !value.is_finite() {
            return Err(self.error(format!("{value} is not a finite number")));
        }
        Ok(value)
    }

    /// A number in `unit`, or a text with a unit of the same dimension; returns the value in SI.
    pub fn quantity(&self, unit: &Unit) -> Result<f64, FileError> {
        let Some(text) = self.value.as_str() else {
            return Ok(unit.to_si(self.number()?));
        };
        let quantity: Quantity = text.parse().map_err(|e| self.error(format!("{e}")))?;
        Ok(unit.to_si(quantity.in_unit(unit).map_err(|e| self.error(e.to_string()))?))
    }

    /// A text with a unit of the expected dimension, or a number where it is unambiguous; returns the value
    /// in SI.
    pub fn signal_value(&self, unit: &SignalUnit) -> Result<f64, FileError> {
        if self.is_text() {
            return self.quantity(unit.unit());
        }
        let value = self.number()?;
        unit.two_readings(value).map_or(Ok(value), |reason| Err(self.error(reason)))
    }

    /// A quantity as [`Node::quantity`] that is not negative.
    pub fn magnitude(&self, unit: &Unit) -> Result<f64, FileError> {
        let value = self.quantity(unit)?;
        if value < 0.0 {
            return Err(self.error("must not be negative"));
        }
        Ok(value)
    }

    pub fn is_text(&self) -> bool {
        self.value.is_str()
    }

    /// An integer of at least 1.
    pub fn count(&self) -> Result<u32, FileError> {
        let value = self.number()?;
        if value < 1.0 || value > f64::from(u32::MAX) || value.fract() != 0.0 {
            return Err(self.error(format!("must be a whole number of at least 1, but is {value}")));
        }
        Ok(value as u32)
    }

    /// The elements of an array, counted from 1 in messages.
    pub fn array(&self) -> Result<Vec<Self>, FileError> {
        let array = self.value.as_array().ok_or_else(|| self.expected("an array [ ... ]"))?;
        Ok(array
            .iter()
            .enumerate()
            .map(|(i, v)| Self::new(self.source, v, format!("{}[{}]", self.path, i + 1)))
            .collect())
    }

    /// A table whose keys must all be in `known`.
    pub fn table(&self, known: &[&str]) -> Result<Table<'a>, FileError> {
        let table = self.open_table()?;
        table.check_keys(known)?;
        Ok(table)
    }

    /// A table whose keys are checked by the caller.
    pub fn open_table(&self) -> Result<Table<'a>, FileError> {
        let entries = self.value.as_table().ok_or_else(|| self.expected("a table { ... }"))?;
        Ok(Table { source: self.source, entries, offset: self.offset, path: self.path.clone() })
    }
}

impl<'a> Table<'a> {
    /// The whole document.
    pub fn document(source: Source<'a>, entries: &'a DeTable<'a>) -> Self {
        Self { source, entries, offset: 0, path: String::new() }
    }

    pub fn check_keys(&self, known: &[&str]) -> Result<(), FileError> {
        let unknown = self.entries.iter().find(|(key, _)| !known.contains(&key.get_ref().as_ref()));
        let Some((key, _)) = unknown else { return Ok(()) };
        let name = key.get_ref().as_ref();
        let reason = format!(
            "unknown key{}; valid keys here are {}",
            did_you_mean(name, known.iter().copied()),
            list(known.iter().copied())
        );
        Err(self.source.error(Some(key.span().start), &self.field(name), reason))
    }

    /// Line-aware error about the table or one of its keys.
    pub fn error(&self, key: Option<&str>, reason: impl Into<String>) -> FileError {
        let found = key.and_then(|key| self.entries.iter().find(|(k, _)| k.get_ref().as_ref() == key));
        let offset = found.map_or(self.offset, |(k, _)| k.span().start);
        let offset = (!self.path.is_empty() || found.is_some()).then_some(offset);
        self.source.error(offset, &key.map_or(self.path.clone(), |k| self.field(k)), reason)
    }

    pub fn get(&self, key: &str) -> Option<Node<'a>> {
        let (_, value) = self.entries.iter().find(|(k, _)| k.get_ref().as_ref() == key)?;
        Some(Node::new(self.source, value, self.field(key)))
    }

    pub fn requirement(&self, key: &str) -> Result<Node<'a>, FileError> {
        self.get(key).ok_or_else(|| self.error(None, format!("{key} is missing")))
    }

    pub fn entries(&self) -> impl Iterator<Item = (&'a str, Node<'a>)> + '_ {
        self.entries.iter().map(|(k, v)| {
            let key = k.get_ref().as_ref();
            (key, Node::new(self.source, v, self.field(key)))
        })
    }

    fn field(&self, key: &str) -> String {
        if self.path.is_empty() { key.into() } else { format!("{}.{key}", self.path) }
    }
}

fn article(noun: &str) -> &'static str {
    if noun.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" }
}
