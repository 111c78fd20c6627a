//! What is remembered: MCAP, CSV and ULog records with units.
//!
//! - [`writer::LogWriter`] writes the messages of a bench to MCAP.
//! - [`record::Record`] is what every reader ends in: one time axis and named signals in SI units.

pub mod bench_info;
pub mod bench_record;
pub mod csv_file;
pub mod diff;
mod fields;
pub mod foreign;
pub mod info;
pub mod log;
pub mod mapping;
mod multi;
pub mod offset;
pub mod read;
pub mod record;
pub mod resample;
pub mod sampling;
mod segment;
pub mod series;
pub mod stream;
pub mod ulog;
pub mod writer;

pub use bench_info::{BenchInfo, SignalInfo};
pub use bench_record::{BenchRecordError, bench_record};
pub use csv_file::{CsvError, read_csv, write_csv};
pub use diff::{BenchDifference, Diff, Difference, TopicDiff, diff};
pub use foreign::{Catalogue, ForeignError, catalogue, read_foreign};
pub use info::{FileInfo, LogInfo, SignalSummary, TopicInfo, info};
pub use log::{Log, Messages};
pub use mapping::{MapError, Mapping, MissingSource, Source};
pub use multi::MultiError;
pub use offset::{OffsetError, TimeOffset, time_offset};
pub use read::{AnyReadError, Exported, Kind, export, kind, read};
pub use record::{MissingSignal, Record, RecordError, Signal};
pub use resample::{Clock, ClockError, resample};
pub use sampling::{Gap, Sampling, pauses, unbroken};
pub use segment::{AttachedFile, Damage, Ending, Topic};
pub use series::Series;
pub use stream::{LogStream, RawMessage, ReadError, segments};
pub use ulog::{UlogCatalogue, UlogError, read_ulog, ulog_catalogue};
pub use writer::{Channel, LogWriter, WriteError, Written};
