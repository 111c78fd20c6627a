//! Logs of many topics, each with its own clock: makes one record from selected signals.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::mapping::{MapError, Mapping, Selected, Source, list, resolve};
use crate::record::Record;
use crate::resample::{Clock, ClockError, resample};
use crate::series::Series;

/// The reason why a log of many topics cannot be made a record.
#[derive(Debug, thiserror::Error)]
pub enum MultiError {
    /// No signals are selected.
    #[error(
        "{} has signals with several time bases: choose signals with --map NAME=SIGNAL[unit]. It has: {}",
        path.display(),
        list(available)
    )]
    Unmapped {
        /// The log.
        path: PathBuf,
        /// Signals that the log has.
        available: Vec<String>,
    },
    /// A mapping does not fit.
    #[error("{error}{}", unreadable_hint(unreadable))]
    Map {
        /// What is wrong.
        error: Box<MapError>,
        /// Topics that cannot be read, with the reason.
        unreadable: Vec<String>,
    },
    /// No sample of a signal could be read.
    #[error("{}: '{name}' has no readable sample{}", path.display(), unreadable_hint(unreadable))]
    Empty {
        /// The log.
        path: PathBuf,
        /// Name of the signal in the log.
        name: String,
        /// Topics that cannot be read, with the reason.
        unreadable: Vec<String>,
    },
    /// There is no common clock.
    #[error("{}: {error}", path.display())]
    Clock {
        /// The log.
        path: PathBuf,
        /// What is wrong.
        error: ClockError,
    },
}

fn unreadable_hint(topics: &[String]) -> String {
    if topics.is_empty() {
        String::new()
    } else {
        format!(". Topics that cannot be read: {}", topics.join("; "))
    }
}

/// Collects the samples of the selected signals.
pub(crate) struct Collector {
    path: PathBuf,
    origin: String,
    sources: Vec<String>,
    selected: Vec<Selected>,
    /// Indices of the signals that each source feeds.
    fed: HashMap<String, Vec<usize>>,
    samples: Vec<Vec<(u64, f64)>>,
}

impl Collector {
    /// Selects signals from those of the log.
    pub fn new(
        path: &Path,
        offered: &[Source],
        unreadable: &[String],
        mappings: &[Mapping],
    ) -> Result<Self, MultiError> {
        let sources: Vec<String> = offered.iter().map(|source| source.name.clone()).collect();
        if mappings.is_empty() {
            return Err(MultiError::Unmapped { path: path.into(), available: sources });
        }
        let origin = path.display().to_string();
        let (selected, _) = resolve(offered, mappings, false, &origin)
            .map_err(|error| MultiError::Map { error: Box::new(error), unreadable: unreadable.to_vec() })?;
        let mut fed: HashMap<String, Vec<usize>> = HashMap::new();
        for (signal, chosen) in selected.iter().enumerate() {
            fed.entry(sources[chosen.source].clone()).or_default().push(signal);
        }
        let samples = vec![Vec::new(); selected.len()];
        Ok(Self { path: path.into(), origin, sources, selected, fed, samples })
    }

    /// Sets a description of the record's origin that says more than the file name.
    pub fn call(&mut self, origin: String) {
        self.origin = origin;
    }

    /// Whether any signal comes from the topic.
    pub fn wants(&self, topic: &str) -> bool {
        self.fed.keys().any(|source| source.strip_prefix(topic).is_some_and(|rest| rest.starts_with('.')))
    }

    /// Whether a signal comes from the source.
    pub fn wants_source(&self, source: &str) -> bool {
        self.fed.contains_key(source)
    }

    /// Takes a sample, if its source is wanted.
    pub fn take(&mut self, source: &str, time_ns: u64, value: f64) {
        for signal in self.fed.get(source).into_iter().flatten() {
            if value.is_finite() {
                self.samples[*signal].push((time_ns, self.selected[*signal].convert(value)));
            }
        }
    }

    /// The record on the clock of the fastest signal, over the time that all signals cover; 0 s is the first
    /// sample of all.
    pub fn finish(self, unreadable: &[String]) -> Result<Record, MultiError> {
        let start = self.samples.iter().flatten().map(|(t, _)| *t).min().unwrap_or(0);
        let mut series = Vec::with_capacity(self.selected.len());
        for (chosen, samples) in self.selected.iter().zip(self.samples) {
            if samples.is_empty() {
                return Err(MultiError::Empty {
                    path: self.path,
                    name: self.sources[chosen.source].clone(),
                    unreadable: unreadable.to_vec(),
                });
            }
            let seconds = samples.into_iter().map(|(t, v)| ((t - start) as f64 / 1e9, v)).collect();
            series.push(Series::new(&chosen.name, chosen.unit.si_symbol(), seconds));
        }
        // By convention the names of inputs begin with u_; a control signal holds until the next sample.
        let held = |name: &str| name.starts_with("u_");
        Clock::common(&series, None)
            .and_then(|clock| resample(&self.origin, &series, &clock, held))
            .map_err(|error| MultiError::Clock { path: self.path, error })
    }
}
