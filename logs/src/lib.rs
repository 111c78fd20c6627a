//! Logs and records: MCAP, CSV, ULog, DataFlash and blackbox, with units.
//!
//! - [`writer::LogWriter`] writes the messages of a bench to MCAP.
//! - [`record::Record`] is the result of every reader: one time axis and named signals in SI units.

pub mod bench_info;
pub mod bench_log;
pub mod bench_record;
pub mod blackbox;
pub mod csv_file;
pub mod dataflash;
pub mod decimate;
pub mod diff;
pub mod events;
mod fields;
pub mod finding_text;
pub mod foreign;
pub mod hole;
pub mod in_charge;
pub mod info;
mod left_out_rows;
pub mod log;
mod log_file;
pub mod mapping;
mod missing_mark;
mod multi;
mod named_schema;
pub mod offset;
mod output;
pub mod panels;
pub mod read;
mod read_error;
pub mod record;
mod record_error;
pub mod resample;
pub mod rounding;
pub mod sampling;
pub mod segments;
pub mod series;
pub mod shown;
pub mod spectrum;
pub mod stats;
pub mod stream;
pub mod topics;
pub mod ulog;
mod wall_clock;
pub mod writer;

pub use bench_info::{BenchInfo, SignalInfo};
pub use bench_log::{BenchMessage, BenchMessages, MessageType, SensorField};
pub use bench_record::{BenchRecordError, IN_CHARGE, bench_record, bench_record_of};
pub use blackbox::{BlackboxError, blackbox_topics, read_blackbox};
pub use csv_file::{CsvError, read_csv, write_csv};
pub use dataflash::{DataflashError, dataflash_topics, read_dataflash};
pub use decimate::{Line, decimate};
pub use diff::{BenchDifference, Diff, Difference, TopicDiff, diff};
pub use events::{Event, EventKind, Events};
pub use foreign::{Catalogue, ForeignError, catalogue, read_foreign};
pub use hole::Hole;
pub use in_charge::InCharge;
pub use info::{FileInfo, LogInfo, SignalSummary, TopicInfo, info};
pub use left_out_rows::LeftOutRows;
pub use log::{Log, Messages};
pub use log_file::{AttachedFile, Damage, Ending, Topic};
pub use mapping::{MapError, Mapping, MissingSource, Source, Unreadable, split_unit};
pub use missing_mark::MissingMark;
pub use multi::MultiError;
pub use named_schema::named_schema;
pub use offset::{OffsetError, TimeOffset, time_offset};
pub use panels::{Panel, PanelChannels, Panels};
pub use read::{AnyReadError, Exported, Kind, export, kind, read, read_signals};
pub use read_error::ReadError;
pub use record::{Record, RecordError, Signal, SignalError};
pub use resample::{Clock, ClockError, resample};
pub use rounding::rounding_step;
pub use sampling::{
    GAP, Gap, LONGEST_BRIDGED, Sampling, even_period, gaps, median_interval, pauses, repeated_every, unbroken,
};
pub use segments::{Segments, log_files};
pub use series::Series;
pub use stream::{LogStream, RawMessage};
pub use topics::{TopicSamples, Topics};
pub use ulog::{UlogError, read_ulog, ulog_topics};
pub use writer::{CDR_HEADER, Channel, EncodedChannel, LogWriter, WriteError, Written};
