//! What is remembered: MCAP, CSV and ULog records with units.
//!
//! - [`writer::LogWriter`] writes the messages of a bench to MCAP.
//! - [`record::Record`] is what every reader ends in: one time axis and named signals in SI units.

pub mod bench_info;
pub mod csv_file;
pub mod mapping;
pub mod record;
pub mod writer;

pub use bench_info::{BenchInfo, SignalInfo};
pub use csv_file::{CsvError, read_csv, write_csv};
pub use mapping::{MapError, Mapping, MissingSource, Source};
pub use record::{MissingSignal, Record, RecordError, Signal};
pub use writer::{Channel, LogWriter, WriteError, Written};
