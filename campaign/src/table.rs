//! The flights of a campaign as a table in a Parquet file, one row per flight.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::basic::{Compression, ConvertedType, LogicalType, Repetition, Type as Physical};
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::record::Field;
use parquet::schema::types::Type;
use serde::{Deserialize, Serialize};

use crate::quantity::{Number, Value};
use crate::shard::{PartsError, Shard};

/// Key of the file's metadata that holds [`TableInfo`] as JSON.
const INFO: &str = "whirlstand.campaign";

/// Key of the file's metadata that holds the SI units of the figures by the names of their columns, as JSON.
const UNITS: &str = "whirlstand.units";

/// How a flight ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Ended {
    /// The flight reached its last step.
    Complete,
    /// The flight ended earlier, for this reason.
    Failed(String),
}

/// One flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// Its number, from 0.
    pub number: u64,
    /// The drawn values, in the order of the columns.
    pub values: Vec<Value>,
    /// How it ended.
    pub ended: Ended,
    /// Whether each limit holds, in the order of the columns; empty where the flight did not reach its end.
    pub holds: Vec<bool>,
    /// The figures, SI, one for each column; `None` for one without a value.
    pub figures: Vec<Option<f64>>,
}

impl Flight {
    /// Whether the flight reached its end within all limits.
    pub fn is_good(&self) -> bool {
        self.ended == Ended::Complete && self.holds.iter().all(|holds| *holds)
    }
}

/// Meaning of the columns.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Columns {
    /// Keys that vary, with their units as drawn.
    pub keys: Vec<(String, String)>,
    /// Limits: key and value, SI.
    pub limits: Vec<(String, f64)>,
    /// Figures.
    pub figures: Vec<FigureColumn>,
}

/// A figure, the values of which are SI.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FigureColumn {
    /// Its key.
    pub key: String,
    /// SI unit; empty for a pure number.
    pub unit: String,
    /// Symbol of the unit in which it is shown.
    pub shown: String,
}

/// Key of the figure that holds a flight's weight under method "importance".
pub const WEIGHT: &str = "weight";

/// Origin of a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TableInfo {
    /// Digest of campaign file, launch file, vehicle file and seed. Tables with another digest belong to another
    /// campaign.
    pub digest: String,
    /// Version of the program.
    pub version: String,
    /// Flights of the whole campaign; fewer where it stopped early.
    pub flights: u64,
    /// The part of the campaign in this table; `None` for the whole.
    pub shard: Option<Shard>,
    /// The campaign file.
    pub text: String,
    /// Columns.
    pub columns: Columns,
}

/// The reason why a table cannot be written, read or joined.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The operating system refused an access.
    #[error("cannot {doing} {path}: {source}")]
    File {
        /// What was tried.
        doing: &'static str,
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not Parquet, or was cut off.
    #[error("{path} cannot be read as Parquet: {reason}")]
    Parquet {
        /// The file.
        path: String,
        /// Why.
        reason: String,
    },
    /// Parquet of something else.
    #[error("{path} is not a campaign table: {reason}")]
    Foreign {
        /// The file.
        path: String,
        /// What is missing.
        reason: String,
    },
    /// Parts that do not make a whole.
    #[error(transparent)]
    Parts(#[from] PartsError),
}

/// A table of flights.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Where it comes from.
    pub info: TableInfo,
    /// The flights, by number.
    pub flights: Vec<Flight>,
}

impl Table {
    /// Writes the table; the same table gives the same bytes.
    ///
    /// # Errors
    /// [`TableError::File`], [`TableError::Parquet`].
    pub fn write(&self, path: &Path) -> Result<(), TableError> {
        let shown = path.display().to_string();
        // The file is renamed when complete, so that a reader never sees an incomplete one.
        let unfinished = path.with_extension("parquet.part");
        let file = |doing, source| TableError::File { doing, path: shown.clone(), source };
        let sink = File::create(&unfinished).map_err(|e| file("write", e))?;
        self.encode(sink).map_err(|e| TableError::Parquet { path: shown.clone(), reason: e.to_string() })?;
        std::fs::rename(&unfinished, path).map_err(|e| file("write", e))
    }

    fn encode(&self, sink: File) -> parquet::errors::Result<()> {
        let columns = &self.info.columns;
        let mut fields = vec![
            field("flight", Physical::INT64, false)?,
            text("ended", false)?,
            field("good", Physical::BOOLEAN, false)?,
        ];
        let words: Vec<bool> = (0..columns.keys.len()).map(|i| self.is_word(i)).collect();
        for ((key, unit), word) in columns.keys.iter().zip(&words) {
            let name = if unit.is_empty() { format!("draw.{key}") } else { format!("draw.{key} [{unit}]") };
            fields.push(if *word { text(&name, false)? } else { field(&name, Physical::DOUBLE, false)? });
        }
        for (key, _) in &columns.limits {
            fields.push(field(&format!("holds.{key}"), Physical::BOOLEAN, true)?);
        }
        for figure in &columns.figures {
            fields.push(field(&figure.key, Physical::DOUBLE, true)?);
        }
        let schema = Arc::new(Type::group_type_builder("flights").with_fields(fields).build()?);
        let units: BTreeMap<&str, &str> =
            columns.figures.iter().map(|f| (f.key.as_str(), f.unit.as_str())).collect();
        let metadata = [(INFO, serde_json::to_string(&self.info)), (UNITS, serde_json::to_string(&units))];
        let metadata: Vec<KeyValue> = metadata
            .into_iter()
            .map(|(key, text)| Ok(KeyValue::new(key.into(), text?)))
            .collect::<serde_json::Result<_>>()
            .map_err(|e| parquet::errors::ParquetError::External(e.into()))?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .set_created_by("whirlstand".into())
            .set_key_value_metadata(Some(metadata))
            .build();
        let mut writer = SerializedFileWriter::new(sink, schema, Arc::new(properties))?;
        let mut group = writer.next_row_group()?;
        let flights = &self.flights;
        let whole: Vec<i64> = flights.iter().map(|f| f.number as i64).collect();
        put::<Int64Type>(&mut group, &whole, None)?;
        let ended = flights.iter().map(|f| match &f.ended {
            Ended::Complete => ByteArray::from("complete"),
            Ended::Failed(why) => ByteArray::from(why.as_str()),
        });
        put::<ByteArrayType>(&mut group, &ended.collect::<Vec<_>>(), None)?;
        put::<BoolType>(&mut group, &flights.iter().map(Flight::is_good).collect::<Vec<_>>(), None)?;
        for (i, word) in words.iter().enumerate() {
            if *word {
                let values = flights.iter().map(|f| ByteArray::from(f.values[i].to_string().as_str()));
                put::<ByteArrayType>(&mut group, &values.collect::<Vec<_>>(), None)?;
            } else {
                let values = flights.iter().map(|f| f.values[i].number().unwrap_or(f64::NAN));
                put::<DoubleType>(&mut group, &values.collect::<Vec<_>>(), None)?;
            }
        }
        for i in 0..columns.limits.len() {
            let holds: Vec<Option<bool>> = flights.iter().map(|f| f.holds.get(i).copied()).collect();
            put_optional::<BoolType>(&mut group, &holds)?;
        }
        for i in 0..columns.figures.len() {
            let figures: Vec<Option<f64>> =
                flights.iter().map(|f| f.figures.get(i).copied().flatten()).collect();
            put_optional::<DoubleType>(&mut group, &figures)?;
        }
        group.close()?;
        writer.close()?;
        Ok(())
    }

    /// Whether a key is drawn as words.
    fn is_word(&self, key: usize) -> bool {
        self.flights.iter().any(|f| f.values.get(key).is_some_and(|v| v.number().is_none()))
    }

    /// Reads a table.
    ///
    /// # Errors
    /// [`TableError`].
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let shown = path.display().to_string();
        let damaged = |e: parquet::errors::ParquetError| TableError::Parquet {
            path: shown.clone(),
            reason: e.to_string(),
        };
        let foreign = |reason: &str| TableError::Foreign { path: shown.clone(), reason: reason.into() };
        let file = File::open(path).map_err(|source| TableError::File {
            doing: "read",
            path: shown.clone(),
            source,
        })?;
        let reader = SerializedFileReader::new(file).map_err(damaged)?;
        let metadata = reader.metadata().file_metadata().key_value_metadata();
        let info = metadata.and_then(|all| all.iter().find(|entry| entry.key == INFO)?.value.clone());
        let info: TableInfo = info
            .and_then(|text| serde_json::from_str(&text).ok())
            .ok_or_else(|| foreign("it has no campaign metadata"))?;
        let mut flights = Vec::new();
        for row in reader.get_row_iter(None).map_err(damaged)? {
            let row = row.map_err(damaged)?;
            let fields: Vec<&Field> = row.get_column_iter().map(|(_, field)| field).collect();
            flights.push(
                flight(&fields, &info.columns).ok_or_else(|| foreign("a row does not match its columns"))?,
            );
        }
        Ok(Self { info, flights })
    }

    /// Joins all parts of a campaign.
    ///
    /// # Errors
    /// When a part is missing, duplicate, or of another campaign.
    pub fn join(parts: Vec<(String, Self)>) -> Result<Self, TableError> {
        let names: Vec<_> = parts.iter().map(|(path, part)| (path.as_str(), part.info.shard)).collect();
        Shard::check_whole(&names)?;
        let mut parts = parts.into_iter();
        // There is one: nothing is no whole.
        let Some((_, mut whole)) = parts.next() else { return Err(PartsError::None.into()) };
        for (path, part) in parts {
            let (a, b) = (&whole.info, &part.info);
            let differs = [
                ("the version of the program", a.version != b.version),
                ("the campaign, its launch file, vehicle or seed", a.digest != b.digest),
                ("the number of flights", a.flights != b.flights),
            ];
            if let Some((what, _)) = differs.into_iter().find(|(_, differs)| *differs) {
                return Err(PartsError::Mixed { path, what }.into());
            }
            whole.flights.extend(part.flights);
        }
        whole.flights.sort_by_key(|f| f.number);
        whole.info.shard = None;
        Ok(whole)
    }
}

fn field(name: &str, physical: Physical, optional: bool) -> parquet::errors::Result<Arc<Type>> {
    let repetition = if optional { Repetition::OPTIONAL } else { Repetition::REQUIRED };
    Type::primitive_type_builder(name, physical).with_repetition(repetition).build().map(Arc::new)
}

fn text(name: &str, optional: bool) -> parquet::errors::Result<Arc<Type>> {
    let repetition = if optional { Repetition::OPTIONAL } else { Repetition::REQUIRED };
    Type::primitive_type_builder(name, Physical::BYTE_ARRAY)
        .with_repetition(repetition)
        .with_logical_type(Some(LogicalType::String))
        .with_converted_type(ConvertedType::UTF8)
        .build()
        .map(Arc::new)
}

fn put<T: parquet::data_type::DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[T::T],
    levels: Option<&[i16]>,
) -> parquet::errors::Result<()> {
    let Some(mut column) = group.next_column()? else { return Ok(()) };
    column.typed::<T>().write_batch(values, levels, None)?;
    column.close()
}

fn put_optional<T: parquet::data_type::DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: &[Option<T::T>],
) -> parquet::errors::Result<()> {
    let levels: Vec<i16> = values.iter().map(|v| i16::from(v.is_some())).collect();
    let present: Vec<T::T> = values.iter().flatten().cloned().collect();
    put::<T>(group, &present, Some(&levels))
}

/// A row as a flight; `None` where a column has another type than it should.
fn flight(fields: &[&Field], columns: &Columns) -> Option<Flight> {
    let mut fields = fields.iter();
    let Field::Long(number) = fields.next()? else { return None };
    let Field::Str(ended) = fields.next()? else { return None };
    let Field::Bool(_) = fields.next()? else { return None };
    let ended = if ended == "complete" { Ended::Complete } else { Ended::Failed(ended.clone()) };
    let mut values = Vec::new();
    for (_, unit) in &columns.keys {
        values.push(match fields.next()? {
            Field::Double(value) => Value::Number(Number { value: *value, unit: unit.clone() }),
            Field::Str(word) => Value::Word(word.clone()),
            _ => return None,
        });
    }
    let mut holds = Vec::new();
    for _ in &columns.limits {
        match fields.next()? {
            Field::Bool(value) => holds.push(*value),
            Field::Null => {}
            _ => return None,
        }
    }
    let mut figures = Vec::new();
    for _ in &columns.figures {
        figures.push(match fields.next()? {
            Field::Double(value) => Some(*value),
            Field::Null => None,
            _ => return None,
        });
    }
    Some(Flight { number: u64::try_from(*number).ok()?, values, ended, holds, figures })
}
