//! Blackbox logs of Betaflight, INAV and Cleanflight: signals `main.gyroADC[0]`, `slow.failsafePhase`,
//! `gps.GPS_speed`.
//!
//! A file may hold several logs, one from every arming to disarming. The signals of the longest log have these
//! names; those of the others contain the number of their log, counted from 1: `main.3.gyroADC[0]`. Units are
//! stated where the format or the header defines them (`scale.rs`); all other fields are the firmware's own
//! numbers. Time is that of the autopilot's clock.
//!
//! The decoder is written for this program: of the usable public crates, one decodes the frames after every
//! self-contained frame against the wrong ones, and both skip damage without reporting it.

mod encoding;
mod frames;
mod header;
mod scale;

use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use self::frames::{Kind, Reading, read};
use self::header::{Frame, Header};
use self::scale::scale;
use crate::mapping::{Mapping, Source};
use crate::multi::{Collector, MultiError};
use crate::record::Record;
use crate::topics::{TopicSamples, Topics};

/// Text at the beginning of a file.
pub const MAGIC: &[u8] = b"H Product:Blackbox flight data";

/// First line of every log in a file.
const MARK: &[u8] = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n";

/// Kinds of frames that hold signals.
const KINDS: [Kind; 3] = [Kind::Main, Kind::Slow, Kind::Gps];

/// Why a blackbox log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BlackboxError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The file does not begin like a blackbox log.
    #[error(
        "{path}: no line 'H Product:Blackbox flight data recorder...' at byte 0: this is not a blackbox log, or its beginning is missing. Copy the log from the flight controller again"
    )]
    NoLog {
        /// The file.
        path: PathBuf,
    },
    /// No log in the file has a header that can be read.
    #[error("{path}: {}. Copy the file from the flight controller again", reasons.join("; "))]
    Header {
        /// The file.
        path: PathBuf,
        /// The logs with their offsets, and the error in each header.
        reasons: Vec<String>,
    },
    /// The signals cannot form a record.
    #[error(transparent)]
    Multi(#[from] MultiError),
}

/// Lists the topics of all logs in a blackbox file with their signals.
///
/// # Errors
/// [`BlackboxError`].
pub fn blackbox_topics(path: &Path) -> Result<Topics, BlackboxError> {
    let data = std::fs::read(path).map_err(|source| BlackboxError::Io { path: path.into(), source })?;
    Ok(Flights::new(path, &data)?.topics())
}

/// Reads the mapped signals of a blackbox log and resamples them to the clock of the fastest one.
///
/// # Errors
/// [`BlackboxError`].
pub fn read_blackbox(path: &Path, mappings: &[Mapping]) -> Result<Record, BlackboxError> {
    let data = std::fs::read(path).map_err(|source| BlackboxError::Io { path: path.into(), source })?;
    let flights = Flights::new(path, &data)?;
    let topics = flights.topics();
    let mut collector = Collector::new(path, &topics.sources(), &topics.remarks, mappings)?;
    let mut wanted = Vec::new();
    for (index, flight) in flights.readable.iter().enumerate() {
        let signals = KINDS.map(|kind| {
            let mut signals = flights.signals(index, kind);
            signals.retain(|signal| collector.wants_source(&signal.source.name));
            signals
        });
        if signals.iter().all(Vec::is_empty) {
            continue;
        }
        wanted.push(flight.number.to_string());
        read(&flight.header, &data[flight.place.clone()], &mut |kind, time_us, values| {
            for signal in &signals[kind as usize] {
                let value = values[signal.field] as f64 * signal.scale;
                collector.take(&signal.source.name, time_us.saturating_mul(1000), value);
            }
        });
    }
    if flights.count > 1 {
        let (path, wanted) = (path.display(), wanted.join(" and "));
        collector.call(format!("{path}, log {wanted} of {}", flights.count));
    }
    Ok(collector.finish(&topics.remarks)?)
}

/// The logs in a file.
struct Flights<'a> {
    path: &'a Path,
    /// Number of logs.
    count: usize,
    /// The logs whose headers can be read.
    readable: Vec<Flight>,
    /// Index of the longest readable log.
    longest: usize,
    /// Errors in the headers of the others.
    unreadable: Vec<String>,
}

/// A log in a file.
struct Flight {
    /// Number of the log, counted from 1.
    number: usize,
    /// Byte range of the log in the file.
    place: Range<usize>,
    header: Header,
    /// Times of the frames, us, by kind.
    times: [Vec<u64>; KINDS.len()],
    reading: Reading,
}

/// A field of the frames.
struct Signal {
    source: Source,
    field: usize,
    scale: f64,
}

impl Flight {
    /// Duration from the first main frame to the last, s.
    fn duration(&self) -> f64 {
        let main = &self.times[Kind::Main as usize];
        main.first().zip(main.last()).map_or(0.0, |(from, to)| (to - from) as f64 / 1e6)
    }

    fn frame(&self, kind: Kind) -> &Frame {
        match kind {
            Kind::Main => &self.header.main,
            Kind::Slow => &self.header.slow,
            Kind::Gps => &self.header.gps,
        }
    }
}

impl<'a> Flights<'a> {
    fn new(path: &'a Path, data: &[u8]) -> Result<Self, BlackboxError> {
        let places = places(data);
        if places.is_empty() {
            return Err(BlackboxError::NoLog { path: path.into() });
        }
        let (mut readable, mut unreadable) = (Vec::new(), Vec::new());
        for (index, place) in places.iter().enumerate() {
            let number = index + 1;
            match Header::parse(&data[place.clone()]) {
                Ok(header) => {
                    let mut times = KINDS.map(|_| Vec::new());
                    let reading = read(&header, &data[place.clone()], &mut |kind, time, _| {
                        times[kind as usize].push(time);
                    });
                    readable.push(Flight { number, place: place.clone(), header, times, reading });
                }
                Err(reason) => {
                    unreadable.push(format!("log {number} at byte {} cannot be read: {reason}", place.start))
                }
            }
        }
        // Of two equally long logs the first is taken.
        let longest = (0..readable.len())
            .rev()
            .max_by(|a, b| readable[*a].duration().total_cmp(&readable[*b].duration()));
        match longest {
            Some(longest) => Ok(Self { path, count: places.len(), readable, longest, unreadable }),
            None => Err(BlackboxError::Header { path: path.into(), reasons: unreadable }),
        }
    }

    /// The name of a topic.
    fn topic(&self, index: usize, kind: Kind) -> String {
        let name = match kind {
            Kind::Main => "main",
            Kind::Slow => "slow",
            Kind::Gps => "gps",
        };
        if index == self.longest { name.into() } else { format!("{name}.{}", self.readable[index].number) }
    }

    /// The signals of a topic.
    fn signals(&self, index: usize, kind: Kind) -> Vec<Signal> {
        let flight = &self.readable[index];
        let topic = self.topic(index, kind);
        let fields = flight.frame(kind).names.iter().enumerate();
        // The iteration counter is not a signal, and the time field is the time axis.
        let fields = fields.filter(|(_, name)| !matches!(name.as_str(), "time" | "loopIteration"));
        fields
            .map(|(field, name)| {
                let (scale, unit) = scale(&flight.header, name);
                let source = Source { name: format!("{topic}.{name}"), unit: unit.map(String::from) };
                Signal { source, field, scale }
            })
            .collect()
    }

    fn topics(&self) -> Topics {
        let mut by_name = BTreeMap::new();
        for (index, flight) in self.readable.iter().enumerate() {
            for kind in KINDS {
                let times = &flight.times[kind as usize];
                if !times.is_empty() {
                    let signals = self.signals(index, kind).into_iter().map(|signal| signal.source).collect();
                    let times_ns = times.iter().map(|time| time.saturating_mul(1000)).collect();
                    by_name.insert(self.topic(index, kind), TopicSamples { signals, times_ns });
                }
            }
        }
        Topics { by_name, remarks: self.remarks() }
    }

    /// Remarks for the user.
    fn remarks(&self) -> Vec<String> {
        let path = self.path.display();
        let mut remarks = Vec::new();
        if self.count > 1 {
            let longest = &self.readable[self.longest];
            let others = self.readable.iter().filter(|flight| flight.number != longest.number);
            let others: Vec<String> = others
                .map(|flight| format!("main.{} of {:.1} s", flight.number, flight.duration()))
                .collect();
            remarks.push(format!(
                "{path} holds {} logs: main, slow and gps are of log {}, the longest, of {:.1} s; the others are {}",
                self.count,
                longest.number,
                longest.duration(),
                if others.is_empty() { "not readable".into() } else { others.join(", ") }
            ));
        }
        for flight in &self.readable {
            let (number, reading) = (flight.number, flight.reading);
            if reading.places > 0 {
                remarks.push(format!(
                    "{path}, log {number}, is damaged: {} bytes in {} places are not valid frames, the first at byte {}; their data are missing",
                    reading.bytes,
                    reading.places,
                    flight.place.start + reading.first
                ));
            }
            if !reading.ended {
                remarks.push(format!(
                    "{path}, log {number}, has no end marker: power was lost, or the memory was full"
                ));
            }
        }
        remarks.extend(self.unreadable.iter().map(|reason| format!("{path}: {reason}")));
        remarks
    }
}

/// Byte ranges of the logs in a file.
fn places(data: &[u8]) -> Vec<Range<usize>> {
    let starts: Vec<usize> = data
        .windows(MARK.len())
        .enumerate()
        .filter(|(_, window)| *window == MARK)
        .map(|(at, _)| at)
        .collect();
    let ends = starts.iter().skip(1).copied().chain([data.len()]);
    starts.iter().copied().zip(ends).map(|(start, end)| start..end).collect()
}
