//! Errors of reading or writing a CSV, with the file, the line and the column.

use std::path::PathBuf;

use super::bounded::{GREATEST, LONGEST_LINE, MOST_COLUMNS};
use crate::mapping::MapError;
use crate::record::RecordError;

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
    /// The header line is missing, or has no time column.
    #[error(
        "{path}, line 1: the first column is '{found}', expected t, t[unit], time[unit] or time_s; --map t=COLUMN[unit] names another (`vehicle new`: --time COLUMN[unit]) of {columns}; t=#[samples] counts the rows, and --period tells the time between them"
    )]
    NoTime {
        /// The file.
        path: PathBuf,
        /// Head of the first column.
        found: String,
        /// Heads of the columns.
        columns: String,
    },
    /// The first line has numbers only.
    #[error(
        "{path}, line 1: '{first}' is a number where the name of a column is expected: the table has no header. Add a first line with a name for each column, such as `t,u_roll,roll_rate[deg/s]`, with commas, semicolons, tabs or blanks between them; `t[samples]` where rows are only counted"
    )]
    NoHeader {
        /// The file.
        path: PathBuf,
        /// First cell.
        first: String,
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
    /// The unit of the time column is not a unit of time.
    #[error("{path}, line 1: the time column is in '{unit}', expected s, ms, us, min or samples")]
    TimeUnit {
        /// The file.
        path: PathBuf,
        /// The unit.
        unit: String,
    },
    /// A line has another number of cells than the header, or is not valid CSV.
    #[error("{path}, line {line}: {reason}")]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// What is wrong.
        reason: String,
    },
    /// Most rows have no time.
    #[error(
        "{path}: {untimed} of {rows} rows have no time in column '{name}'; choose another column (--map t=COLUMN[unit])"
    )]
    Untimed {
        /// The file.
        path: PathBuf,
        /// Head of the column.
        name: String,
        /// Rows without a time.
        untimed: usize,
        /// All rows.
        rows: usize,
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
        /// Head of the column.
        name: String,
        /// Text of the cell.
        found: String,
    },
    /// A number is greater than any physical quantity.
    #[error(
        "{path}, line {line}, column {column} ({name}): {found:e} exceeds {GREATEST:e}, which is not a plausible measurement; leave the cell empty for a gap"
    )]
    Greatest {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
        /// Column, counted from 1.
        column: usize,
        /// Head of the column.
        name: String,
        /// Value of the cell.
        found: f64,
    },
    /// No line has a value in a column.
    #[error("{path}, column {column} ({name}): the column has no values")]
    Empty {
        /// The file.
        path: PathBuf,
        /// Column, counted from 1.
        column: usize,
        /// Head of the column.
        name: String,
    },
    /// There are more columns than a table of signals has.
    #[error(
        "{path}, line 1: {found} columns, but at most {MOST_COLUMNS} are supported; keep only those that are needed"
    )]
    Columns {
        /// The file.
        path: PathBuf,
        /// Number of columns.
        found: usize,
    },
    /// A line is too long for a line of numbers.
    #[error(
        "{path}, line {line}: the line has more than {LONGEST_LINE} bytes, too many for a line of numbers; check for an unclosed quote or another file type"
    )]
    Long {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: u64,
    },
    /// The time goes back.
    #[error("{path}, line {line}: time {found} comes after {before}; it must not go back from line to line")]
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
    /// Most rows have other values at the time of the row before.
    #[error(
        "{path}: {repeated} of {rows} rows have other values at the time of the row before; the time column is too coarse, use another one or, for rows at a constant rate, one that counts them (--map t=COLUMN[samples])"
    )]
    CoarseTime {
        /// The file.
        path: PathBuf,
        /// Rows with other values at the time of the row before.
        repeated: usize,
        /// These and all other times.
        rows: usize,
    },
    /// The signals cannot form a record.
    #[error(transparent)]
    Record(#[from] RecordError),
}
