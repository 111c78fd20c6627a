//! CSV files: first column `t` in s or `t[unit]`, heads `name` or `name[unit]`, empty cells and `NaN` for gaps.
//!
//! Lines that begin with `#` are comments. A semicolon, a tab or blanks are accepted as the separator as well as a comma,
//! according to the header line; numbers may then have a decimal comma.

mod blanks;
mod bounded;
mod error;
mod write;

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use csv::{ByteRecord, ReaderBuilder, StringRecord, Trim};
use whirlstand_msgs::units::Unit;

use self::blanks::SingleBlanks;
use self::bounded::{Allowance, Bounded, GREATEST, LONGEST_LINE, MOST_COLUMNS};
pub use self::error::CsvError;
pub use self::write::{format_csv, write_csv};
use crate::left_out_rows::LeftOutRows;
use crate::mapping::{Mapping, Selected, Source, Unreadable, resolve, split_unit};
use crate::record::Record;

/// Most characters of a cell that a message quotes.
const SHOWN: usize = 40;
/// Source of the time in a mapping of a table that has no column for it: its rows are counted.
const ROW_NUMBER: &str = "#";
/// Largest number of columns that an error lists.
const COLUMNS_TOLD: usize = 12;

/// Reads a CSV file into SI units. Mapped columns get their new names; the others keep theirs.
///
/// # Errors
/// [`CsvError`], which names file, line and column.
pub fn read_csv(path: impl AsRef<Path>, mappings: &[Mapping]) -> Result<Record, CsvError> {
    let path = path.as_ref();
    let file = File::open(path).map_err(|source| CsvError::Io { path: path.into(), source })?;
    parse_csv(file, path, mappings)
}

/// Reads CSV text from any reader; `path` is its name in errors.
///
/// # Errors
/// [`CsvError`], which names file, line and column.
pub fn parse_csv(input: impl Read, path: &Path, mappings: &[Mapping]) -> Result<Record, CsvError> {
    let io = |source| CsvError::Io { path: path.into(), source };
    let mut input = BufReader::with_capacity(1 << 16, input);
    skip_byte_order_mark(&mut input).map_err(io)?;
    let delimiter = delimiter(input.fill_buf().map_err(io)?);
    let allowance = Allowance::new(LONGEST_LINE);
    // A comment at the end would be a row if its line had no end.
    let input = input.chain(&b"\n"[..]);
    let input: Box<dyn Read> =
        if delimiter == b' ' { Box::new(SingleBlanks::new(input)) } else { Box::new(input) };
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
    let heads = heads(path, reader.headers().map_err(|e| failed(e, 1))?)?;
    let columns = Columns::new(path, &heads, mappings)?;

    let mut time = Vec::new();
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); columns.signals.len()];
    // A column of text that is not requested by name causes no error.
    let mut unreadable: Vec<Option<CsvError>> = columns.signals.iter().map(|_| None).collect();
    let mut row = ByteRecord::new();
    let (mut before, mut left_out) = (f64::NEG_INFINITY, LeftOutRows::default());
    let parse = if delimiter == b',' { number } else { number_with_decimal_comma };
    loop {
        allowance.renew();
        let more = reader.read_byte_record(&mut row);
        let line = row.position().map_or(0, csv::Position::line);
        if !more.map_err(|e| failed(e, line))? {
            break;
        }
        let cell = |index: usize| parse(&row[index]).map_err(|wrong| wrong.at(path, line, index, &heads));
        let t = columns.time.map_or(Ok(time.len() as f64), cell)?;
        if t.is_nan() {
            left_out.untimed += 1;
            continue;
        }
        if t < before {
            return Err(CsvError::Time { path: path.into(), line, before, found: t });
        }
        // Rows at the same time are one. Of two samples of a signal there the later one holds, as in logs of other kinds
        // (`Series::new`).
        let (is_same, mut replaces) = (t == before, false);
        if !is_same {
            before = t;
            time.push(columns.time_unit.to_si(t));
        }
        for (i, column) in columns.signals.iter().enumerate() {
            if unreadable[i].is_some() {
                continue;
            }
            match cell(columns.sources[column.source]) {
                Ok(value) => replaces |= put(&mut values[i], column.convert(value), is_same),
                Err(error) if i < columns.mapped => return Err(error),
                Err(error) => unreadable[i] = Some(error),
            }
        }
        left_out.repeated += usize::from(replaces);
    }
    let LeftOutRows { repeated, untimed } = left_out;
    if repeated > time.len() {
        return Err(CsvError::CoarseTime { path: path.into(), repeated, rows: repeated + time.len() });
    }
    if let Some(at) = columns.time.filter(|_| untimed > time.len()) {
        let name = excerpt(&heads[at]);
        return Err(CsvError::Untimed { path: path.into(), name, untimed, rows: untimed + time.len() });
    }
    // Growing vectors reserve up to twice the memory that they use.
    time.shrink_to_fit();
    values.iter_mut().for_each(Vec::shrink_to_fit);
    Ok(columns.record(path, &heads, time, values, unreadable)?.with_left_out_rows(left_out))
}

/// The names of the columns.
fn heads(path: &Path, line: &StringRecord) -> Result<Vec<String>, CsvError> {
    if line.len() > MOST_COLUMNS {
        return Err(CsvError::Columns { path: path.into(), found: line.len() });
    }
    let is_number = |head: &str| head.trim().parse::<f64>().is_ok();
    match line.get(0).filter(|first| !first.is_empty() && line.iter().all(is_number)) {
        Some(first) => Err(CsvError::NoHeader { path: path.into(), first: excerpt(first) }),
        None => Ok(line.iter().map(str::to_string).collect()),
    }
}

/// Adds a value of a row to those of its signal; in a row at the time of the row before, a value takes the place of that
/// row's. True where it is another one.
fn put(values: &mut Vec<f64>, value: f64, is_same_time: bool) -> bool {
    match values.last_mut().filter(|_| is_same_time) {
        Some(_) if value.is_nan() => false,
        Some(earlier) => {
            let replaces = !earlier.is_nan() && value != *earlier;
            *earlier = value;
            replaces
        }
        None => {
            values.push(value);
            false
        }
    }
}

/// Contents of the header line.
struct Columns {
    /// Column index of the time; `None` where the rows are counted.
    time: Option<usize>,
    time_unit: Unit,
    /// Column index of each source.
    sources: Vec<usize>,
    signals: Vec<Selected>,
    /// Number of signals that the user mapped; they come first.
    mapped: usize,
    unreadable: Vec<Unreadable>,
}

impl Columns {
    /// The record of these columns, from their values and the errors found in them.
    fn record(
        self,
        path: &Path,
        heads: &[String],
        time: Vec<f64>,
        values: Vec<Vec<f64>>,
        wrong: Vec<Option<CsvError>>,
    ) -> Result<Record, CsvError> {
        let mut record = Record::new(path.display().to_string(), time)?;
        record.time_unit = self.time_unit.si_symbol();
        let mut left_out = self.unreadable;
        for (i, ((column, signal), error)) in self.signals.into_iter().zip(values).zip(wrong).enumerate() {
            let empty = || {
                let index = self.sources[column.source];
                CsvError::Empty { path: path.into(), column: index + 1, name: excerpt(&heads[index]) }
            };
            let is_empty = !signal.is_empty() && signal.iter().all(|v| v.is_nan());
            match error.or_else(|| is_empty.then(empty)) {
                Some(error) if i < self.mapped => return Err(error),
                Some(error) => left_out.push(Unreadable { name: column.name, why: error.to_string() }),
                None => {
                    let (name, unit) = (column.name.clone(), column.unit.si_symbol());
                    record.push_read(name, unit, signal, |number| column.convert(number))?;
                }
            }
        }
        Ok(record.with_unreadable(left_out))
    }

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
        let (time, time_unit) = match time_column(&offered, of_time, &origin)? {
            Some(found) => found,
            None => {
                let found = excerpt(heads.first().map_or("", String::as_str));
                let heads: Vec<String> = heads.iter().map(|head| excerpt(head)).collect();
                let listed = heads.iter().take(COLUMNS_TOLD).map(|head| format!("'{head}'"));
                let more = heads.len().saturating_sub(COLUMNS_TOLD);
                let more = (more > 0).then(|| format!("{more} more"));
                let columns = match listed.chain(more).collect::<Vec<_>>() {
                    none if none.is_empty() => "none".into(),
                    some => some.join(", "),
                };
                return Err(CsvError::NoTime { path: path.into(), found, columns });
            }
        };
        // A time column without a unit is in s.
        let time_unit = if time_unit == Unit::ONE { Unit::SECOND } else { time_unit };
        if !["s", "samples"].contains(&time_unit.si_symbol().as_str()) {
            let unit = time_unit.si_symbol();
            return Err(CsvError::TimeUnit { path: path.into(), unit });
        }
        let once = |i: &usize| Some(*i) != time && !twice.contains(&offered[*i].name);
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

/// The column of the time, `None` where rows are counted, and its unit: what is mapped, else what is the time by its name.
fn time_column(
    offered: &[Source],
    mut mapped: Vec<Mapping>,
    origin: &str,
) -> Result<Option<(Option<usize>, Unit)>, CsvError> {
    if mapped.iter().any(|m| m.names(ROW_NUMBER)) && offered.iter().all(|source| source.name != ROW_NUMBER) {
        return Ok(Some((None, Unit::SAMPLES)));
    }
    if mapped.is_empty()
        && let Some(named) = named_time(offered)
    {
        mapped.push(named.parse()?);
    }
    Ok(resolve(offered, &mapped, false, origin)?.0.first().map(|m| (Some(m.source), m.unit)))
}

/// The mapping of the column that is the time by its name: the first, or the only one.
fn named_time(offered: &[Source]) -> Option<String> {
    let first = offered.first().and_then(time_mapping);
    let mut named = offered.iter().filter_map(time_mapping);
    first.or_else(|| named.next().filter(|_| named.next().is_none()))
}

/// The mapping of a column that is the time by its name: `t`, or a usual name with a unit, which may be its ending, as in
/// `time_s` and `timestamp_us`. Such a name without a unit is ambiguous.
fn time_mapping(source: &Source) -> Option<String> {
    const NAMES: [&str; 3] = ["t", "time", "timestamp"];
    let Source { name, unit } = source;
    let lower = name.to_ascii_lowercase();
    if name == "t" || unit.is_some() && NAMES.contains(&lower.as_str()) {
        return Some(format!("t={name}"));
    }
    let (stem, ending) = lower.rsplit_once('_')?;
    let is_told = unit.is_none() && NAMES.contains(&stem) && ["s", "ms", "us"].contains(&ending);
    is_told.then(|| format!("t={name}[{ending}]"))
}

/// What is wrong with the contents of a cell.
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

/// A text for a message, shortened if it is long.
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

/// As [`number`], of a table whose cells are not separated by commas.
fn number_with_decimal_comma(cell: &[u8]) -> Result<f64, WrongCell> {
    match cell.iter().position(|b| *b == b',') {
        Some(at) if !cell.contains(&b'.') => {
            let mut pointed = cell.to_vec();
            pointed[at] = b'.';
            number(&pointed)
                .map_err(|_| WrongCell::NoNumber(excerpt(&String::from_utf8_lossy(cell.trim_ascii()))))
        }
        _ => number(cell),
    }
}

fn skip_byte_order_mark(input: &mut impl BufRead) -> std::io::Result<()> {
    if input.fill_buf()?.starts_with(b"\xef\xbb\xbf") {
        input.consume(3);
    }
    Ok(())
}

/// The separator of the header line.
fn delimiter(start: &[u8]) -> u8 {
    let head = start.split(|b| *b == b'\n').find(|line| !line.starts_with(b"#")).unwrap_or(start);
    if head.contains(&b',') {
        return b',';
    }
    let separator = [b';', b'\t'].into_iter().find(|d| head.contains(d));
    separator.or_else(|| head.trim_ascii().contains(&b' ').then_some(b' ')).unwrap_or(b',')
}

fn line_error(path: &Path, error: csv::Error) -> CsvError {
    let path = path.to_path_buf();
    let line = error.position().map_or(1, csv::Position::line);
    match error.into_kind() {
        csv::ErrorKind::Io(source) => CsvError::Io { path, source },
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => CsvError::Line {
            path,
            line,
            reason: format!("{len} cells, but the header has {expected_len} columns"),
        },
        csv::ErrorKind::Utf8 { .. } => {
            CsvError::Line { path, line, reason: "the header is not UTF-8 text".into() }
        }
        other => CsvError::Line { path, line, reason: format!("{other:?}") },
    }
}

#[cfg(test)]
mod tests;
