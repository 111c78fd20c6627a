//! Reads a log: first the signals that it has, then the chosen ones as a record.

use std::path::Path;

use whirlstand_logs::{
    AnyReadError, Kind, LogInfo, Mapping, Record, TopicInfo, info, kind, median_interval, read,
};

use super::error::DraftError;
use super::proposal::{Chosen, Offered};

/// A log whose signals were listed.
pub struct Opened {
    /// Signals in the log.
    pub offered: Vec<Offered>,
    /// True when every topic has a clock of its own.
    pub clocks: bool,
}

/// Lists the signals of a log. `time` names the time column of a CSV, as in `--map t=`.
///
/// # Errors
/// [`DraftError::Read`].
fn open(path: &Path, time: Option<&str>) -> Result<Opened, DraftError> {
    let io = |source| AnyReadError::Io { path: path.into(), source };
    let table = match kind(path).map_err(io)? {
        Kind::Csv => true,
        Kind::Mcap => whirlstand_logs::Log::open(path).map_err(AnyReadError::from)?.info().is_some(),
        Kind::Ulog | Kind::Dataflash | Kind::Blackbox => false,
    };
    if table {
        let record = read(path, &mappings(&[], time)?)?;
        let one = |s: &whirlstand_logs::Signal| Offered {
            name: s.name.clone(),
            unit: Some(s.unit.clone()).filter(|u| !u.is_empty()),
            rate_hz: None,
            largest: s.values.iter().map(|v| v.abs()).filter(|v| v.is_finite()).reduce(f64::max),
        };
        return Ok(Opened { offered: record.signals().iter().map(one).collect(), clocks: false });
    }
    Ok(Opened { offered: signals_of(&info(path)?), clocks: true })
}

/// Lists the signals of the first of several logs of one vehicle, with their largest values in all of them.
///
/// # Errors
/// [`DraftError::Read`].
pub fn open_all<P: AsRef<Path>>(paths: &[P], time: Option<&str>) -> Result<Opened, DraftError> {
    let mut logs = paths.iter().map(|path| open(path.as_ref(), time));
    let mut first = logs.next().unwrap_or(Ok(Opened { offered: Vec::new(), clocks: false }))?;
    for other in logs {
        let other = other?;
        for signal in &mut first.offered {
            let same = other.offered.iter().find(|o| o.name == signal.name);
            signal.largest = signal.largest.into_iter().chain(same.and_then(|o| o.largest)).reduce(f64::max);
        }
    }
    Ok(first)
}

/// The signals of all topics.
fn signals_of(log: &LogInfo) -> Vec<Offered> {
    let topic = |topic: &TopicInfo| {
        let rate = rate_hz(topic);
        let one = move |signal: &String| {
            let (name, unit) = whirlstand_logs::split_unit(signal);
            Offered { name: name.into(), unit: unit.map(Into::into), rate_hz: Some(rate), largest: None }
        };
        topic.signals.iter().map(one).collect::<Vec<_>>()
    };
    log.topics.iter().flat_map(topic).collect()
}

/// Messages of a topic per second. For a topic that arrives in bursts, the mean rate describes it better than the
/// median interval; the longest pause, as between two flights, is no part of it.
fn rate_hz(topic: &TopicInfo) -> f64 {
    let pause = topic.longest_gap.map_or(0.0, |gap| gap.to - gap.from);
    let mean = (topic.messages as f64 - 1.0) / (topic.to - topic.from - pause).max(1e-9);
    topic.rate_hz.map_or(mean, |rate| rate.min(2.0 * mean)).max(0.0)
}

fn mappings(chosen: &[&Chosen], time: Option<&str>) -> Result<Vec<Mapping>, DraftError> {
    let texts = chosen.iter().map(|c| format!("{}={}", c.name, c.source));
    let time = time.map(|column| format!("t={column}"));
    texts
        .chain(time)
        .map(|text| text.parse::<Mapping>().map_err(|e| DraftError::from(AnyReadError::from(e))))
        .collect()
}

/// Reads the chosen signals, in the part of the log between two times; rows that are only counted are `period_s` apart.
///
/// # Errors
/// [`DraftError::Read`].
pub fn read_chosen(
    path: &Path,
    chosen: &[&Chosen],
    (time, period_s): (Option<&str>, Option<f64>),
    (from, to): (Option<f64>, Option<f64>),
) -> Result<Record, DraftError> {
    let record = read(path, &mappings(chosen, time)?)?;
    let names: Vec<String> = chosen.iter().map(|c| c.name.clone()).collect();
    let mut record = record.only(&names).map_err(AnyReadError::from)?;
    if let Some(period_s) = period_s.filter(|_| record.time_unit == "samples") {
        record = record.with_sample_period(period_s);
    }
    let whole = (from.unwrap_or(f64::NEG_INFINITY), to.unwrap_or(f64::INFINITY));
    Ok(if from.is_some() || to.is_some() { record.between(whole.0, whole.1) } else { record })
}

/// Sampling interval of a signal, s: that of its topic, else the median time between two changes of its
/// value. `None` for a constant signal.
pub fn interval(record: &Record, chosen: &Chosen) -> Option<f64> {
    if chosen.interval_s.is_some() {
        return chosen.interval_s;
    }
    let values = &record.get(&chosen.name)?.values;
    let known = || record.time.iter().zip(values).filter(|(_, v)| v.is_finite());
    let mut last = f64::NAN;
    let mut changes = Vec::new();
    for (t, v) in known() {
        if *v != last {
            changes.push(*t);
            last = *v;
        }
    }
    median_interval(&changes)
}

/// Sampling interval of an input, s: that of its topic, else of the record. In a table a command that stays the same is held: a
/// step, or a binary sequence.
pub fn input_interval(record: &Record, chosen: &Chosen) -> Option<f64> {
    chosen.interval_s.or_else(|| record.period())
}

/// The samples of an output without interpolated ones: of a signal sampled more slowly than the record, only
/// every n-th point, since interpolated values show no noise.
pub fn own_samples(record: &Record, chosen: &Chosen) -> Vec<f64> {
    samples(record, chosen, interval(record, chosen))
}

/// The samples of a signal, `every_s` apart.
pub fn samples(record: &Record, chosen: &Chosen, every_s: Option<f64>) -> Vec<f64> {
    let step = record.period().unwrap_or(0.0).max(1e-9);
    let every = every_s.map_or(1, |s| (s / step).round().max(1.0) as usize);
    let values = record.get(&chosen.name).map_or(&[][..], |signal| &signal.values);
    values.iter().copied().filter(|v| v.is_finite()).step_by(every).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_column_has_the_interval_of_its_changes() {
        let mut record = Record::new("x", (0..100).map(|k| k as f64 * 0.01).collect()).unwrap();
        record.push("u", "", (0..100).map(|k| f64::from(k / 5)).collect()).unwrap();
        record.push("c", "", vec![1.0; 100]).unwrap();
        let chosen = |name: &str, interval_s| Chosen {
            name: name.into(),
            source: name.into(),
            interval_s,
            why: String::new(),
        };
        assert!((interval(&record, &chosen("u", None)).unwrap() - 0.05).abs() < 1e-9);
        assert_eq!(interval(&record, &chosen("u", Some(0.2))), Some(0.2));
        assert_eq!(interval(&record, &chosen("c", None)), None);
    }

    #[test]
    fn a_pause_between_two_flights_does_not_slow_a_topic_and_bursts_do() {
        let topic =
            |messages: u64, rate_hz: f64, to: f64, longest_gap: Option<whirlstand_logs::Gap>| TopicInfo {
                name: "RATE".into(),
                message_type: "RATE".into(),
                encoding: "dataflash".into(),
                messages,
                from: 0.0,
                to,
                rate_hz: Some(rate_hz),
                lost: 0,
                gaps: usize::from(longest_gap.is_some()),
                longest_gap,
                signals: Vec::new(),
            };
        let pause = whirlstand_logs::Gap { after: 1000, from: 20.0, to: 420.0, missing: 20_000 };
        assert_eq!(rate_hz(&topic(2001, 50.0, 440.0, Some(pause))), 50.0);
        // Ten messages a millisecond apart, ten times a second.
        assert!((rate_hz(&topic(1001, 1000.0, 10.0, None)) - 200.0).abs() < 1e-9);
    }

    #[test]
    fn a_table_offers_its_columns_with_their_units() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("log.csv");
        std::fs::write(&path, "t,u_roll,p[deg/s]\n0,0,1\n0.1,1,2\n0.2,0,3\n").unwrap();
        let log = open(&path, None).unwrap();
        assert!(!log.clocks);
        assert_eq!(log.offered[1].unit.as_deref(), Some("rad/s"));
        let chosen =
            Chosen { name: "roll_rate".into(), source: "p".into(), interval_s: None, why: String::new() };
        let record = read_chosen(&path, &[&chosen], (None, None), (Some(0.05), None)).unwrap();
        assert_eq!(record.names(), ["roll_rate"]);
        assert_eq!(record.len(), 2);
    }
}
