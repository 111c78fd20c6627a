//! CSV: first column `t` in s or `t[unit]`, heads `name` or `name[unit]`, empty cells and `NaN` for gaps.
//!
//! Lines that begin with `#` are comments. A semicolon or a tab separates as well as a comma, if the head says so.

mod write;

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use csv::{ByteRecord, ReaderBuilder, Trim};
use whirlstand_msgs::units::Unit;

pub use self::write::{format_csv, write_csv};
use crate::mapping::{MapError, Mapping, Selected, Source, Unreadable, resolve, split_unit};
use crate::record::{Record, RecordError};

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
    let mut reader = ReaderBuilder::new()
        .delimiter(delimiter)
        .comment(Some(b'#'))
        .trim(Trim::Headers)
        .buffer_capacity(1 << 16)
        .from_reader(input);
    let failed = |error: csv::Error| line_error(path, error);
    let heads: Vec<String> = reader.headers().map_err(failed)?.iter().map(str::to_string).collect();
    let columns = Columns::new(path, &heads, mappings)?;

    let mut time = Vec::new();
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); columns.signals.len()];
    // A column of text that nobody has named is in nobody's way, until it is asked for.
    let mut unreadable: Vec<Option<CsvError>> = columns.signals.iter().map(|_| None).collect();
    let mut row = ByteRecord::new();
    let mut before = f64::NEG_INFINITY;
    while reader.read_byte_record(&mut row).map_err(failed)? {
        let line = row.position().map_or(0, csv::Position::line);
        let cell = |index: usize| {
            number(&row[index]).map_err(|found| CsvError::Cell {
                path: path.into(),
                line,
                column: index + 1,
                name: heads[index].clone(),
                found,
            })
        };
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
    for ((column, signal), error) in columns.signals.into_iter().zip(values).zip(unreadable) {
        match error {
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
        for (i, Source { name, .. }) in offered.iter().enumerate() {
            if offered[..i].iter().any(|other| other.name == *name) && !twice.contains(name) {
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
                let found = heads.first().cloned().unwrap_or_default();
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

/// A finite number, or NaN for a gap.
fn number(cell: &[u8]) -> Result<f64, String> {
    let cell = cell.trim_ascii();
    if cell.is_empty() {
        return Ok(f64::NAN);
    }
    let parsed = std::str::from_utf8(cell).ok().and_then(|text| text.parse::<f64>().ok());
    match parsed {
        Some(value) if !value.is_infinite() => Ok(value),
        _ => Err(String::from_utf8_lossy(cell).into_owned()),
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
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str, maps: &[&str]) -> Result<Record, CsvError> {
        let mappings: Vec<Mapping> = maps.iter().map(|m| m.parse().unwrap()).collect();
        parse_csv(text.as_bytes(), Path::new("flight.csv"), &mappings)
    }

    #[test]
    fn units_become_si_and_gaps_become_nan() {
        let text = "# a comment\nt[ms],roll[deg],u_roll, v [m/s]\n0,180, 0.5,1\n10,,NaN,-2e0\n";
        let record = parse(text, &[]).unwrap();
        assert_eq!(record.time, [0.0, 0.01]);
        let roll = record.signal("roll").unwrap();
        assert_eq!((roll.unit.as_str(), roll.values[0]), ("rad", std::f64::consts::PI));
        assert!(roll.values[1].is_nan() && record.signal("u_roll").unwrap().values[1].is_nan());
        assert_eq!(record.signal("v").unwrap().values, [1.0, -2.0]);
    }

    #[test]
    fn time_may_be_samples_or_another_column() {
        let record = parse("t[samples],y[V]\n0,1\n1,2\n", &[]).unwrap();
        assert_eq!(record.time_unit, "samples");
        let record = record.with_sample_period(0.5);
        assert_eq!((record.time_unit.as_str(), record.time[1]), ("s", 0.5));
        let record = parse("y,stamp\n1,0\n2,1000\n", &["t=stamp[us]", "roll=-y[deg]"]).unwrap();
        assert_eq!(record.time, [0.0, 1e-3]);
        assert_eq!(record.names(), ["roll"]);
    }

    #[test]
    fn other_separators_and_byte_order_marks_are_read() {
        assert_eq!(parse("\u{feff}t;y\n0;1\n", &[]).unwrap().names(), ["y"]);
        assert_eq!(parse("t\ty\n0\t1\n", &[]).unwrap().names(), ["y"]);
    }

    /// A mode in words, a unit that nobody knows, a name that comes twice: nobody who asks for other columns is stopped.
    #[test]
    fn a_column_that_cannot_be_read_is_an_error_where_it_is_asked_for() {
        let cases = [
            (
                "t,roll,y\n0,1,2\n1,2,x\n",
                "flight.csv, line 3, column 3 (y): 'x' is not a finite number; leave the cell empty for a gap",
            ),
            (
                "t,roll,y\n0,1,inf\n1,2,3\n",
                "flight.csv, line 2, column 3 (y): 'inf' is not a finite number; leave the cell empty for a gap",
            ),
            ("t,y,roll,y[deg]\n0,3,1,3\n1,3,2,3\n", "flight.csv, line 1: two columns are called 'y'"),
            ("t,roll,y[furlong]\n0,1,3\n1,2,3\n", "signal 'y' of flight.csv: 'furlong'"),
        ];
        for (text, expected) in cases {
            let record = parse(text, &[]).unwrap();
            assert_eq!(
                (record.names(), record.signal("roll").unwrap().values[1]),
                (vec!["roll".into()], 2.0)
            );
            let error = record.signal("y").unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
            assert_eq!(record.find("y").unwrap_err().to_string(), error);
            assert_eq!(record.between(0.0, 0.5).signal("y").unwrap_err().to_string(), error);
            assert_eq!(record.unreadable()[0].name, "y");
            let error = parse(text, &["pitch=y"]).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{error}");
        }
    }

    #[test]
    fn errors_name_file_line_and_column() {
        let cases = [
            (
                "",
                "flight.csv, line 1: the first column is '', expected t or t[unit]; --map t=COLUMN[unit] names another",
            ),
            (
                "time,y\n0,1\n",
                "flight.csv, line 1: the first column is 'time', expected t or t[unit]; --map t=COLUMN[unit] names another",
            ),
            ("t[m],y\n", "flight.csv, line 1: the time column is in 'm', expected s, ms, us, min or samples"),
            (
                "t,y\n0,1\n0,2\n",
                "flight.csv, line 3: time 0 is not after 0; it must increase from line to line",
            ),
            ("t,y\n,1\n", "flight.csv, line 2: there is no time in column 1"),
            ("t,y\n0,1,2\n", "flight.csv, line 2: 3 cells, but the head has 2 columns"),
        ];
        for (text, expected) in cases {
            assert_eq!(parse(text, &[]).unwrap_err().to_string(), expected);
        }
        let unit = parse("t,y[furlong]\n0,1\n", &["roll=y"]).unwrap_err().to_string();
        assert!(unit.starts_with("signal 'y' of flight.csv: 'furlong'"), "{unit}");
        assert!(
            read_csv("/does/not/exist.csv", &[])
                .unwrap_err()
                .to_string()
                .starts_with("/does/not/exist.csv: ")
        );
    }

    prop_compose! {
        fn any_record()(rows in 0usize..40, columns in 0usize..5)(
            steps in prop::collection::vec(1e-6f64..10.0, rows),
            start in -1e6f64..1e6,
            values in prop::collection::vec(
                prop::collection::vec(prop_oneof![prop::num::f64::NORMAL | prop::num::f64::ZERO, Just(f64::NAN)], rows),
                columns,
            ),
        ) -> Record {
            let time = steps.iter().scan(start, |t, dt| { *t += dt; Some(*t) }).collect();
            let mut record = Record::new("round.csv", time).unwrap();
            for (i, v) in values.into_iter().enumerate() {
                record.push(format!("s,{i} \"q\""), ["rad/s", "", "m/s^2"][i % 3], v).unwrap();
            }
            record
        }
    }

    proptest! {
        #[test]
        fn a_written_record_reads_back_bit_for_bit(record in any_record()) {
            let mut text = Vec::new();
            format_csv(&record, &mut text).unwrap();
            let back = parse_csv(&text[..], Path::new("round.csv"), &[]).unwrap();
            let bits = |v: &[f64]| v.iter().map(|x| if x.is_nan() { 0 } else { x.to_bits() }).collect::<Vec<_>>();
            prop_assert_eq!(bits(&back.time), bits(&record.time));
            prop_assert_eq!(back.names(), record.names());
            for (a, b) in back.signals().iter().zip(record.signals()) {
                prop_assert_eq!(&a.unit, &b.unit);
                prop_assert_eq!(bits(&a.values), bits(&b.values));
            }
        }

        #[test]
        fn any_text_is_a_record_or_an_error(text in "[t,y;\\[\\]\n\r\"0-9.e#\u{0}é-]{0,80}") {
            let _ = parse(&text, &[]);
        }
    }
}
