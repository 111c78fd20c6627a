//! Records: one time axis and named signals in SI units. They are the result of every reader and the input of
//! all analyses.

use serde::Serialize;
use whirlstand_msgs::units::Unit;

use crate::left_out_rows::LeftOutRows;
use crate::mapping::{MapError, Mapping, Source, Unreadable, resolve};
use crate::missing_mark::{MissingMark, take_out};
pub use crate::record_error::{RecordError, SignalError};

/// A named signal over the time axis of its [`Record`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Signal {
    /// Name, as in the vehicle file where it is known there.
    pub name: String,
    /// SI unit in the syntax of [`whirlstand_msgs::units::Unit`]; empty for a pure number.
    pub unit: String,
    /// One value per point of the time axis; NaN where there is none.
    pub values: Vec<f64>,
}

/// Signals over one time axis, in SI units.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Record {
    /// Origin of the record, for messages to the user.
    pub origin: String,
    /// Unit of `time`: `s`, or `samples` for a record without a known clock.
    pub time_unit: String,
    /// Time axis, strictly increasing.
    pub time: Vec<f64>,
    /// Time of the first point of the whole record, for a record that is a part of another.
    #[serde(skip)]
    whole_from: Option<f64>,
    signals: Vec<Signal>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    unreadable: Vec<Unreadable>,
    #[serde(skip)]
    missing_marks: Vec<MissingMark>,
    #[serde(skip)]
    left_out_rows: LeftOutRows,
}

impl Record {
    /// A record without signals, its time in s.
    ///
    /// # Errors
    /// [`RecordError::Time`] when the time axis does not increase strictly or is not finite.
    pub fn new(origin: impl Into<String>, time: Vec<f64>) -> Result<Self, RecordError> {
        let origin = origin.into();
        if time.first().is_some_and(|t| !t.is_finite()) {
            return Err(RecordError::Time { origin, index: 0 });
        }
        match time.windows(2).position(|t| !(t[1] > t[0] && t[1].is_finite())) {
            Some(index) => Err(RecordError::Time { origin, index }),
            None => Ok(Self {
                origin,
                time_unit: "s".into(),
                time,
                whole_from: None,
                signals: Vec::new(),
                unreadable: Vec::new(),
                missing_marks: Vec::new(),
                left_out_rows: LeftOutRows::default(),
            }),
        }
    }

    /// Adds a signal in SI units.
    ///
    /// # Errors
    /// [`RecordError::Duplicate`] and [`RecordError::Length`].
    pub fn push(
        &mut self,
        name: impl Into<String>,
        unit: impl Into<String>,
        values: Vec<f64>,
    ) -> Result<(), RecordError> {
        let (name, origin) = (name.into(), || self.origin.clone());
        if values.len() != self.time.len() {
            let (found, expected) = (values.len(), self.time.len());
            return Err(RecordError::Length { origin: origin(), name, found, expected });
        }
        if self.get(&name).is_some() {
            return Err(RecordError::Duplicate { origin: origin(), name });
        }
        self.signals.push(Signal { name, unit: unit.into(), values });
        Ok(())
    }

    /// All signals, in the order of the file.
    pub fn signals(&self) -> &[Signal] {
        &self.signals
    }

    /// Names of all signals, in the order of the file.
    pub fn names(&self) -> Vec<String> {
        self.signals.iter().map(|s| s.name.clone()).collect()
    }

    /// The signal called `name`, if there is one.
    pub fn get(&self, name: &str) -> Option<&Signal> {
        self.signals.iter().find(|s| s.name == name)
    }

    /// The signal called `name`, which the record may lack.
    ///
    /// # Errors
    /// [`SignalError::Unreadable`] when the record has it and it cannot be read.
    pub fn find(&self, name: &str) -> Result<Option<&Signal>, SignalError> {
        match self.unreadable.iter().find(|u| u.name == name) {
            Some(unreadable) => Err(SignalError::Unreadable(unreadable.clone())),
            None => Ok(self.get(name)),
        }
    }

    /// The signal called `name`.
    ///
    /// # Errors
    /// [`SignalError`], which lists what the record has or says why it cannot be read.
    pub fn signal(&self, name: &str) -> Result<&Signal, SignalError> {
        self.find(name)?.ok_or_else(|| SignalError::Missing {
            origin: self.origin.clone(),
            wanted: name.into(),
            available: self.names(),
        })
    }

    /// Signals that the file has and that could not be read.
    pub fn unreadable(&self) -> &[Unreadable] {
        &self.unreadable
    }

    /// The record, in which a signal whose unit is not compatible with the expected one is marked as unreadable.
    /// `expected` holds names with their SI units. A signal without a unit is assumed to have the expected one.
    pub fn expecting<'n>(mut self, expected: impl IntoIterator<Item = (&'n str, &'n Unit)>) -> Self {
        for (name, unit) in expected {
            let Some(at) = self.signals.iter().position(|s| s.name == name) else { continue };
            let found = self.signals[at].unit.parse::<Unit>().map_or(unit.dimension(), |u| u.dimension());
            if found.is_none() || found == unit.dimension() {
                continue;
            }
            let signal = self.signals.remove(at);
            let wanted = if unit.dimension().is_none() { "a pure number".into() } else { unit.si_symbol() };
            let why = format!(
                "signal '{name}' of {} is in {}, but {wanted} is expected: use --map {name}=NAME[unit] to choose \
                 another signal, or another unit for this one",
                self.origin, signal.unit
            );
            self.unreadable.push(Unreadable { name: signal.name, why });
        }
        self
    }

    /// Numbers that stood for missing values, which are NaN now.
    pub fn missing_marks(&self) -> &[MissingMark] {
        &self.missing_marks
    }

    /// Rows of the file that are left out.
    pub fn left_out_rows(&self) -> LeftOutRows {
        self.left_out_rows
    }

    /// Stores which rows are left out.
    pub(crate) fn with_left_out_rows(mut self, rows: LeftOutRows) -> Self {
        self.left_out_rows = rows;
        self
    }

    /// Adds a signal of a file as [`Record::push`], without the numbers that stand for missing values. `convert` turns a number
    /// of the file into one of the signal.
    pub(crate) fn push_read(
        &mut self,
        name: String,
        unit: String,
        mut values: Vec<f64>,
        convert: impl Fn(f64) -> f64,
    ) -> Result<(), RecordError> {
        if let Some((mark, cells)) = take_out(&mut values, convert) {
            self.missing_marks.push(MissingMark { name: name.clone(), mark, cells });
        }
        self.push(name, unit, values)
    }

    /// Stores the signals of the file that could not be read.
    pub(crate) fn with_unreadable(mut self, unreadable: Vec<Unreadable>) -> Self {
        self.unreadable.extend(unreadable);
        self
    }

    /// Replaces the values of a signal; there must be one per point in time.
    pub(crate) fn replace(&mut self, signal: usize, values: Vec<f64>) {
        debug_assert_eq!(values.len(), self.time.len());
        self.signals[signal].values = values;
    }

    /// Extracts time axis and signals, in the order of the record.
    pub fn into_signals(self) -> (Vec<f64>, Vec<Signal>) {
        (self.time, self.signals)
    }

    /// Number of points in time.
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// True when there is no point in time.
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// Time from the first point to the last; 0 for fewer than two.
    pub fn duration(&self) -> f64 {
        match (self.time.first(), self.time.last()) {
            (Some(first), Some(last)) => last - first,
            _ => 0.0,
        }
    }

    /// Time of the first point of the whole record, of which this may be a part. Effects that depend on time count
    /// from there.
    pub fn begins_at(&self) -> f64 {
        self.whole_from.or(self.time.first().copied()).unwrap_or(0.0)
    }

    /// The points with `from <= t <= to`, as a record of its own with the same time axis.
    pub fn between(&self, from: f64, to: f64) -> Self {
        let start = self.time.partition_point(|t| *t < from);
        let end = self.time.partition_point(|t| *t <= to).max(start);
        self.part(self.time[start..end].to_vec(), |values| values[start..end].to_vec())
    }

    /// The points of this record and those of another, which follow after a pause of `pause_s` on the same time axis:
    /// records of one vehicle, one after the other. Signals that this record does not have are left out.
    ///
    /// # Errors
    /// [`SignalError`] when the other record lacks a signal of this one.
    pub fn followed_by(mut self, next: &Self, pause_s: f64) -> Result<Self, SignalError> {
        for signal in &mut self.signals {
            signal.values.extend(&next.signal(&signal.name)?.values);
        }
        let begins = next.time.first().copied().unwrap_or(0.0);
        let end = self.time.last().map_or(begins, |last| last + pause_s);
        self.time.extend(next.time.iter().map(|t| end + (t - begins)));
        self.origin = format!("{}, {}", self.origin, next.origin);
        self.left_out_rows += next.left_out_rows;
        for mark in &next.missing_marks {
            match self.missing_marks.iter_mut().find(|own| own.name == mark.name && own.mark == mark.mark) {
                Some(own) => own.cells += mark.cells,
                None => self.missing_marks.push(mark.clone()),
            }
        }
        Ok(self)
    }

    /// The `kept` points as a separate record; omitted points leave gaps in its time axis.
    pub fn keep(&self, kept: &[bool]) -> Self {
        fn chosen(values: &[f64], kept: &[bool]) -> Vec<f64> {
            values.iter().zip(kept).filter(|(_, kept)| **kept).map(|(value, _)| *value).collect()
        }
        self.part(chosen(&self.time, kept), |values| chosen(values, kept))
    }

    /// A part of the record: some of its points.
    fn part(&self, time: Vec<f64>, of: impl Fn(&[f64]) -> Vec<f64>) -> Self {
        Self {
            origin: self.origin.clone(),
            time_unit: self.time_unit.clone(),
            time,
            whole_from: Some(self.begins_at()),
            signals: self
                .signals
                .iter()
                .map(|s| Signal { values: of(&s.values), ..s.clone_head() })
                .collect(),
            unreadable: self.unreadable.clone(),
            missing_marks: self.missing_marks.clone(),
            left_out_rows: self.left_out_rows,
        }
    }

    /// The record with only the named signals, in that order.
    ///
    /// # Errors
    /// [`SignalError`].
    pub fn only(&self, names: &[String]) -> Result<Self, SignalError> {
        let signals = names.iter().map(|n| self.signal(n).cloned()).collect::<Result<_, _>>()?;
        Ok(Self {
            signals,
            unreadable: Vec::new(),
            missing_marks: self.missing_marks.iter().filter(|m| names.contains(&m.name)).cloned().collect(),
            left_out_rows: self.left_out_rows,
            time: self.time.clone(),
            whole_from: self.whole_from,
            origin: self.origin.clone(),
            time_unit: self.time_unit.clone(),
        })
    }

    /// The record with its signals renamed; those that no mapping names keep their names.
    ///
    /// # Errors
    /// [`MapError`] when a mapping does not fit.
    pub fn mapped(self, mappings: &[Mapping]) -> Result<Self, MapError> {
        if mappings.is_empty() {
            return Ok(self);
        }
        let sources: Vec<Source> = self
            .signals
            .iter()
            .map(|s| Source { name: s.name.clone(), unit: Some(s.unit.clone()) })
            .collect();
        let (selected, unreadable) = resolve(&sources, mappings, true, &self.origin)?;
        let signals = selected
            .into_iter()
            .map(|chosen| Signal {
                unit: chosen.unit.si_symbol(),
                values: self.signals[chosen.source].values.iter().map(|v| chosen.convert(*v)).collect(),
                name: chosen.name,
            })
            .collect();
        Ok(Self { signals, ..self }.with_unreadable(unreadable))
    }

    /// Gives a record without a known clock its sampling period: point n is at n times `period_s`.
    pub fn with_sample_period(mut self, period_s: f64) -> Self {
        if self.time_unit == "samples" {
            self.time.iter_mut().chain(&mut self.whole_from).for_each(|t| *t *= period_s);
            self.time_unit = "s".into();
        }
        self
    }
}

impl Signal {
    /// The signal without its values.
    pub(crate) fn clone_head(&self) -> Self {
        Self { name: self.name.clone(), unit: self.unit.clone(), values: Vec::new() }
    }
}

#[cfg(test)]
mod tests;
