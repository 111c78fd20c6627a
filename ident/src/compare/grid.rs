//! A record on an even grid, with the names of the vehicle's signals.

use std::borrow::Cow;

use whirlstand_logs::resample::{averaged, held, interpolated};
use whirlstand_logs::{Clock, Record, SignalError, even_period, median_interval};
use whirlstand_vehicle::Vehicle;

use super::comparison::{CompareError, CompareOptions};
use super::gaps::{bridged_s, input_through_gaps};

/// Fewest points of a comparison.
const LEAST_POINTS: usize = 16;

/// Largest number of steps, for the sake of memory.
const MOST_STEPS: f64 = 50e6;

/// Ratio to the record's own period from which a period is coarser: several samples are then averaged to one
/// point.
const COARSER: f64 = 1.5;

/// Inputs and outputs on an even grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Time of the first point in the record, s.
    pub start_s: f64,
    /// Steps from the beginning of the whole record, at which the clock of effects starts, to the first
    /// point.
    pub first_step: u64,
    /// Time between two points, s.
    pub period_s: f64,
    /// Time of every point, s of the record's clock.
    pub t: Vec<f64>,
    /// Inputs, SI: steps x inputs, row after row; on a straight line through gaps, and else the last value
    /// where the record has none.
    pub inputs: Vec<f64>,
    /// Indices of the vehicle's outputs that the record has.
    pub outputs: Vec<usize>,
    /// Measured values, SI: one vector for each entry of `outputs`; NaN where the record has no value.
    pub measured: Vec<Vec<f64>>,
    /// Share of the record's steps that are more than half a period off the median step, 0 to 1.
    pub uneven: f64,
}

/// Resamples `record` onto an even grid.
pub fn grid(record: &Record, vehicle: &Vehicle, options: &CompareOptions) -> Result<Grid, CompareError> {
    let mut record = Cow::Borrowed(record);
    if record.time_unit == "samples" {
        let Some(period_s) = options.period_s else {
            return Err(CompareError::NoClock { origin: record.origin.clone() });
        };
        record = Cow::Owned(record.into_owned().with_sample_period(period_s));
    }
    let even = (record.time_unit == "s").then(|| even_period(&record.time)).flatten();
    let even = even.filter(|own| options.period_s.is_none_or(|wanted| (wanted / own - 1.0).abs() < 1e-4));
    if options.from_s.is_some() || options.until_s.is_some() {
        let (from, until) =
            (options.from_s.unwrap_or(f64::NEG_INFINITY), options.until_s.unwrap_or(f64::INFINITY));
        record = Cow::Owned(record.between(from, until));
    }
    // On an even clock the samples are taken unchanged: rounded time stamps must not smear them.
    let time = match even {
        Some(period_s) => Cow::Owned(straightened(&record.time, period_s)),
        None => Cow::Borrowed(&record.time[..]),
    };
    let inputs =
        vehicle.inputs.iter().map(|i| record.signal(&i.name)).collect::<Result<Vec<_>, SignalError>>()?;
    let mut found = Vec::new();
    for (i, output) in vehicle.outputs.iter().enumerate() {
        found.extend(record.find(&output.name)?.map(|_| i));
    }
    if found.is_empty() {
        return Err(CompareError::NoOutput {
            origin: record.origin.clone(),
            vehicle: vehicle.name.clone(),
            outputs: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
            available: record.names(),
        });
    }
    let own = median_interval(&time).unwrap_or(0.0);
    let clock = clock((&record.origin, &time), even.or(options.period_s).unwrap_or(own), own)?;
    let longest = bridged_s(&record, vehicle, own);
    let columns = inputs.iter().map(|s| {
        let (time, values) = input_through_gaps(&time, &s.values, longest);
        held(&time, &values, &clock, 0.0)
    });
    let columns: Vec<Vec<f64>> = columns.collect();
    let brought = if clock.period > COARSER * own { averaged } else { interpolated };
    let measured = found.iter().map(|&i| {
        // The signal exists, as the filter above found it.
        let values = record.get(&vehicle.outputs[i].name).map_or(&[][..], |s| &s.values);
        brought(&time, values, &clock)
    });
    Ok(Grid {
        start_s: clock.start,
        first_step: ((clock.start - record.begins_at()) / clock.period).round().max(0.0) as u64,
        period_s: clock.period,
        inputs: (0..clock.points).flat_map(|k| columns.iter().map(move |c| c[k])).collect(),
        measured: measured.collect(),
        outputs: found,
        t: clock.times(),
        uneven: uneven(&time, own),
    })
}

/// Grid times from the first sample of the record to its last.
fn clock((origin, time): (&str, &[f64]), period_s: f64, own: f64) -> Result<Clock, CompareError> {
    let duration_s = time.first().zip(time.last()).map_or(0.0, |(first, last)| last - first);
    // A record without two different times has no sampling interval.
    let steps = if own > 0.0 { duration_s / period_s } else { 0.0 };
    if steps > MOST_STEPS {
        return Err(CompareError::TooFine { duration_s, period_s });
    }
    let start_s = time.first().copied().unwrap_or(0.0);
    match Clock::over(start_s, start_s + duration_s, period_s) {
        Ok(clock) if steps > 0.0 && clock.points >= LEAST_POINTS => Ok(clock),
        other => {
            let points = if steps > 0.0 { other.map_or(0, |clock| clock.points) } else { 0 };
            Err(CompareError::TooShort { origin: origin.into(), points, period_s })
        }
    }
}

/// Share of a clock's steps that are more than half a median step off the median, 0 to 1.
fn uneven(time: &[f64], own: f64) -> f64 {
    let steps = || time.windows(2).map(|t| t[1] - t[0]);
    steps().filter(|s| (s - own).abs() > 0.5 * own).count() as f64 / steps().count().max(1) as f64
}

/// The same number of times on an exactly even clock.
fn straightened(time: &[f64], period_s: f64) -> Vec<f64> {
    let first = time.first().copied().unwrap_or(0.0);
    (0..time.len()).map(|k| first + k as f64 * period_s).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_stamps_of_an_even_clock_do_not_smear_the_samples() {
        let period_s = 0.0016384;
        let rounded = |k: usize| ((100.0 + k as f64 * period_s) * 1e4).round() / 1e4;
        let mut csv = "t[s],u_roll,u_pitch,roll[deg]\n".to_string();
        for k in 0..400 {
            csv.push_str(&format!("{},{},0,{}\n", rounded(k), (k % 5) as f64, (k % 7) as f64));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        std::fs::write(&path, csv).unwrap();
        let record = whirlstand_logs::read(&path, &[]).unwrap();
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let options = CompareOptions { from_s: Some(100.1), ..CompareOptions::default() };
        let grid = grid(&record, &vehicle, &options).unwrap();
        let first = record.time.iter().position(|t| *t >= 100.1).unwrap();
        assert!((grid.period_s - period_s).abs() < 1e-6, "{}", grid.period_s);
        for (k, value) in grid.measured[0].iter().enumerate() {
            let expected = ((first + k) % 7) as f64;
            assert!((value.to_degrees() - expected).abs() < 1e-9, "{k}: {value}");
            assert!((grid.inputs[2 * k] - ((first + k) % 5) as f64).abs() < 1e-9);
        }
    }
}
