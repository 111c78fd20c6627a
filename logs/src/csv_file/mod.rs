//! CSV: first column `t` in s or `t[unit]`, heads `name` or `name[unit]`, empty cells and `NaN` for gaps.
//!
//! Lines that begin with `#` are comments. A semicolon or a tab separates as well as a comma, if the head says so.

mod bounded;
mod write;

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use csv::{ByteRecord, ReaderBuilder, Trim};
use whirlstand_msgs::units::Unit;

use self::bounded::{Allowance, Bounded};
pub use self::write::{format_csv, write_csv};
use crate::mapping::{MapError, Mapping, Selected, Source, Unreadable, resolve, split_unit};
use crate::record::{Record, RecordError};

/// Most columns of a file. Logs of autopilots with every topic in one table have some thousands; what has more is no table
/// of signals over time, and names in that number cost more than the numbers.
const MOST_COLUMNS: usize = 10_000;

/// Most bytes of a line, with the comments before it: [`MOST_COLUMNS`] numbers of full precision are a twentieth of it.
const LONGEST_LINE: usize = 4 << 20;

/// Greatest size of a number. No quantity of a flight comes near it in any unit, and it leaves room to square and to add
/// without an overflow; what is greater is the "no value" of somebody's logger, such as the greatest single precision number.
const GREATEST: f64 = 1e30;

/// Most characters of a cell that a message repeats.
const SHOWN: usize = 40;

/// Why a CSV cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CsvError {
    /// The file cannot be opened, read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// There is no head, or no time in it.
    #[error(
        "{path}, line 1: the first column is '{found}', expected t or t[unit]; --map t=COLUMN[unit] names another"
    )]
    NoTime {
        /// The file.
        path: PathBuf,
        /// What the first column is called.
        found: String,
    },
    /// Two columns have one name.
    #[error("{path}, line 1: two columns are called '{name}'")]
    Duplicate {
        /// The file.
        path: PathBuf,
        /// The name.
        name: String,
    },
    /// A unit or a mapping does not fit.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The time is not in a unit of time.
    #[error("{path}, line 1: the time column is in '{unit}', expected s, ms, us, min or samples")]
    TimeUnit {
        /// The file.
        path: PathBuf,
        /// The unit.
        unit: String,
    },
    /// A line is not as long as the head, or is not CSV.
    #[error("{path}, line {line}: {reason}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
    /// A cell is not a number.
    #[error(
        "{path}, line {line}, column {column} ({name}): '{found}' is not a finite number; leave the cell empty for a gap"
    )]
    Cell {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// Column, counted from 1.
        column: usize,
        /// Its head.
        name: String,
        /// What stands there.
        found: String,
    },
    /// A cell is beyond all measure.
    #[error(
        "{path}, line {line}, column {column} ({name}): {found:e} is beyond {GREATEST:e}, which nothing measured is; leave the cell empty for a gap"
    )]
    Greatest {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// Column, counted from 1.
        column: usize,
        /// Its head.
        name: String,
        /// What stands there.
        found: f64,
    },
    /// No line has a value in a column.
    #[error("{path}, column {column} ({name}): no line has a value there")]
    Empty {
        /// The file.
        path: PathBuf,
        /// Column, counted from 1.
        column: usize,
        /// Its head.
        name: String,
    },
    /// More columns than a table of signals has.
    #[error(
        "{path}, line 1: {found} columns, but at most {MOST_COLUMNS} are read; keep those that are needed"
    )]
    Columns {
        /// The file.
        path: PathBuf,
        /// How many there are.
        found: usize,
    },
    /// A line that is no line of numbers.
    #[error(
        "{path}, line {line}: more than {LONGEST_LINE} bytes in one line, which no line of numbers has; is a quote open, or is this another kind of file?"
    )]
    Long {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
    },
    /// Time stands still or goes back.
    #[error("{path}, line {line}: time {found} is not after {before}; it must increase from line to line")]
    Time {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// The time before, in the file's unit.
        before: f64,
        /// The time here, in the file's unit.
        found: f64,
    },
    /// The signals do not make a record.
    #[error(transparent)]
    Record(#[from] RecordError),
}

/// Reads a CSV file into SI units. Mapped columns get their new names; the others keep theirs.
///
/// # Errors
/// [`CsvError`], which names file, line and column.
pub fn read_csv(path: impl AsRef<Path>, mappings: &[Mapping]) -> Result<Record, CsvError> {
    let path = path.as_ref();
    let file = File::open(path).map_err(|source| CsvError::Io { path: path.into(), source })?;
    parse_csv(file, path, mappings)
}

/// Reads CSV text from anywhere; `path` is what errors call it.
///
/// # Errors
/// [`CsvError`], which names file, line and column.
pub fn parse_csv(input: impl Read, path: &Path, mappings: &[Mapping]) -> Result<Record, CsvError> {
    let io = |source| CsvError::Io { path: path.into(), source };
    let mut input = BufReader::with_capacity(1 << 16, input);
    skip_byte_order_mark(&mut input).map_err(io)?;
    let delimiter = delimiter(input.fill_buf().map_err(io)?);
    let allowance = Allowance::new(LONGEST_LINE);
    let mut reader = ReaderBuilder::new()
        .delimiter(delimiter)
        .comment(Some(b'#'))
        .trim(Trim::Headers)
        .buffer_capacity(1 << 16)
        .from_reader(Bounded::new(input, &allowance));
    let failed = |error: csv::Error, line: u64| match allowance.is_used_up() {
        true => CsvError::Long { path: path.into(), line },
        false => line_error(path, error),
    };
    let heads = reader.headers().map_err(|e| failed(e, 1))?;
    if heads.len() > MOST_COLUMNS {
        return Err(CsvError::Columns { path: path.into(), found: heads.len() });
    }
    let heads: Vec<String> = heads.iter().map(str::to_string).collect();
    let columns = Columns::new(path, &heads, mappings)?;

    let mut time = Vec::new();
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); columns.signals.len()];
    // A column of text that nobody has named is in nobody's way, until it is asked for.
    let mut unreadable: Vec<Option<CsvError>> = columns.signals.iter().map(|_| None).collect();
    let mut row = ByteRecord::new();
    let mut before = f64::NEG_INFINITY;
    loop {
        allowance.renew();
        let more = reader.read_byte_record(&mut row);
        let line = row.position().map_or(0, csv::Position::line);
        if !more.map_err(|e| failed(e, line))? {
            break;
        }
        let cell = |index: usize| number(&row[index]).map_err(|wrong| wrong.at(path, line, index, &heads));
        let t = cell(columns.time)?;
        if t.is_nan() {
            let reason = format!("there is no time in column {}", columns.time + 1);
            return Err(CsvError::Line { path: path.into(), line, reason });
        }
        if t <= before {
            return Err(CsvError::Time { path: path.into(), line, before, found: t });
        }
        before = t;
        time.push(columns.time_unit.to_si(t));
        for (i, column) in columns.signals.iter().enumerate() {
            if unreadable[i].is_some() {
                continue;
            }
            match cell(columns.sources[column.source]) {
                Ok(value) => values[i].push(column.convert(value)),
                Err(error) if i < columns.mapped => return Err(error),
                Err(error) => unreadable[i] = Some(error),
            }
        }
    }
    let mut record = Record::new(path.display().to_string(), time)?;
    record.time_unit = columns.time_unit.si_symbol();
    let mut left_out = columns.unreadable;
    for (i, ((column, signal), error)) in columns.signals.into_iter().zip(values).zip(unreadable).enumerate()
    {
        let empty = || {
            let index = columns.sources[column.source];
            CsvError::Empty { path: path.into(), column: index + 1, name: excerpt(&heads[index]) }
        };
        let is_empty = !signal.is_empty() && signal.iter().all(|v| v.is_nan());
        let error = error.or_else(|| is_empty.then(empty));
        match error {
            Some(error) if i < columns.mapped => return Err(error),
            Some(error) => left_out.push(Unreadable { name: column.name, why: error.to_string() }),
            None => record.push(column.name, column.unit.si_symbol(), signal)?,
        }
    }
    Ok(record.with_unreadable(left_out))
}

/// What the head says.
struct Columns {
    time: usize,
    time_unit: Unit,
    /// Column of each source.
    sources: Vec<usize>,
    signals: Vec<Selected>,
    /// How many of the signals the user named: they come first.
    mapped: usize,
    unreadable: Vec<Unreadable>,
}

impl Columns {
    fn new(path: &Path, heads: &[String], mappings: &[Mapping]) -> Result<Self, CsvError> {
        let origin = path.display().to_string();
        let offered: Vec<Source> = heads
            .iter()
            .map(|head| {
                let (name, unit) = split_unit(head);
                Source { name: name.into(), unit: unit.map(str::to_string) }
            })
            .collect();
        let mut twice: Vec<String> = Vec::new();
        let mut seen = HashSet::new();
        for Source { name, .. } in &offered {
            if !seen.insert(name) && !twice.contains(name) {
                if mappings.iter().any(|m| m.names(name)) || name == "t" {
                    return Err(CsvError::Duplicate { path: path.into(), name: name.clone() });
                }
                twice.push(name.clone());
            }
        }
        let (of_time, of_signals): (Vec<_>, Vec<_>) = mappings.iter().cloned().partition(|m| m.name == "t");
        let (time, time_unit) = match resolve(&offered, &of_time, false, &origin)?.0.first() {
            Some(mapped) => (mapped.source, mapped.unit),
            None if offered.first().is_some_and(|s| s.name == "t") => {
                let t: Mapping = "t=t".parse()?;
                (0, resolve(&offered, &[t], false, &origin)?.0[0].unit)
            }
            None => {
                let found = excerpt(heads.first().map_or("", String::as_str));
                return Err(CsvError::NoTime { path: path.into(), found });
            }
        };
        // A bare t is in s.
        let time_unit = if time_unit == Unit::ONE { Unit::SECOND } else { time_unit };
        if !["s", "samples"].contains(&time_unit.si_symbol().as_str()) {
            let unit = time_unit.si_symbol();
            return Err(CsvError::TimeUnit { path: path.into(), unit });
        }
        let once = |i: &usize| *i != time && !twice.contains(&offered[*i].name);
        let sources: Vec<usize> = (0..heads.len()).filter(once).collect();
        let rest: Vec<Source> = sources.iter().map(|i| offered[*i].clone()).collect();
        let (signals, mut unreadable) = resolve(&rest, &of_signals, true, &origin)?;
        unreadable.extend(twice.into_iter().map(|name| {
            let why = CsvError::Duplicate { path: path.into(), name: name.clone() }.to_string();
            Unreadable { name, why }
        }));
        Ok(Self { time, time_unit, sources, signals, mapped: of_signals.len(), unreadable })
    }
}

/// What is wrong with a cell.
enum WrongCell {
    NoNumber(String),
    TooGreat(f64),
}

impl WrongCell {
    fn at(self, path: &Path, line: u64, index: usize, heads: &[String]) -> CsvError {
        let (path, column, name) = (path.to_path_buf(), index + 1, excerpt(&heads[index]));
        match self {
            Self::NoNumber(found) => CsvError::Cell { path, line, column, name, found },
            Self::TooGreat(found) => CsvError::Greatest { path, line, column, name, found },
        }
    }
}

/// A text for a message, cut when it is long.
fn excerpt(text: &str) -> String {
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}... ({} bytes)", &text[..end], text.len()),
        None => text.into(),
    }
}

/// A finite number, or NaN for a gap.
fn number(cell: &[u8]) -> Result<f64, WrongCell> {
    let cell = cell.trim_ascii();
    if cell.is_empty() {
        return Ok(f64::NAN);
    }
    let parsed = std::str::from_utf8(cell).ok().and_then(|text| text.parse::<f64>().ok());
    match parsed {
        Some(value) if value.is_nan() || value.abs() <= GREATEST => Ok(value),
        Some(value) if value.is_finite() => Err(WrongCell::TooGreat(value)),
        _ => Err(WrongCell::NoNumber(excerpt(&String::from_utf8_lossy(cell)))),
    }
}

fn skip_byte_order_mark(input: &mut impl BufRead) -> std::io::Result<()> {
    if input.fill_buf()?.starts_with(b"\xef\xbb\xbf") {
        input.consume(3);
    }
    Ok(())
}

/// The separator that the head line uses.
fn delimiter(start: &[u8]) -> u8 {
    let head = start.split(|b| *b == b'\n').find(|line| !line.starts_with(b"#")).unwrap_or(start);
    if head.contains(&b',') {
        return b',';
    }
    [b';', b'\t'].into_iter().find(|d| head.contains(d)).unwrap_or(b',')
}

fn line_error(path: &Path, error: csv::Error) -> CsvError {
    let path = path.to_path_buf();
    let line = error.position().map_or(1, csv::Position::line);
    match error.into_kind() {
        csv::ErrorKind::Io(source) => CsvError::Io { path, source },
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => CsvError::Line {
            path,
            line,
            reason: format!("{len} cells, but the head has {expected_len} columns"),
        },
        csv::ErrorKind::Utf8 { .. } => {
            CsvError::Line { path, line, reason: "the head is not UTF-8 text".into() }
        }
        other => CsvError::Line { path, line, reason: format!("{other:?}") },
    }
}

#[cfg(test)]
mod tests;
