//! A record on an even grid, with the names of the vehicle.

use whirlstand_logs::{MissingSignal, Record};
use whirlstand_vehicle::Vehicle;

use super::{CompareError, CompareOptions};
use crate::stats::median;

/// Inputs and outputs on an even grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Time of the first point in the record, s.
    pub start_s: f64,
    /// Period, s.
    pub period_s: f64,
    /// Times, s.
    pub t: Vec<f64>,
    /// Steps by inputs, row after row; held where the record has none.
    pub inputs: Vec<f64>,
    /// Indices of the vehicle's outputs that the record has.
    pub outputs: Vec<usize>,
    /// One vector an output of `outputs`; NaN where the record has no value.
    pub measured: Vec<Vec<f64>>,
    /// Share of the record's steps that are more than half a period off the median step, 0 to 1.
    pub uneven: f64,
}

/// Brings `record` onto an even grid.
pub fn grid(record: &Record, vehicle: &Vehicle, options: &CompareOptions) -> Result<Grid, CompareError> {
    let mut record = std::borrow::Cow::Borrowed(record);
    if record.time_unit == "samples" {
        let Some(period_s) = options.period_s else {
            return Err(CompareError::NoClock { origin: record.origin.clone() });
        };
        record = std::borrow::Cow::Owned(record.into_owned().with_sample_period(period_s));
    }
    let even = (record.time_unit == "s").then(|| even_period(&record.time)).flatten();
    let even = even.filter(|own| options.period_s.is_none_or(|wanted| (wanted / own - 1.0).abs() < 1e-4));
    if options.from_s.is_some() || options.until_s.is_some() {
        let (from, until) =
            (options.from_s.unwrap_or(f64::NEG_INFINITY), options.until_s.unwrap_or(f64::INFINITY));
        record = std::borrow::Cow::Owned(record.between(from, until));
    }
    if let Some(period_s) = even {
        // On an even clock the samples are taken as they are: stamps that were rounded must not smear them.
        straighten(record.to_mut(), period_s);
    }
    let inputs =
        vehicle.inputs.iter().map(|i| record.signal(&i.name)).collect::<Result<Vec<_>, MissingSignal>>()?;
    let found: Vec<usize> =
        (0..vehicle.outputs.len()).filter(|&i| record.get(&vehicle.outputs[i].name).is_some()).collect();
    if found.is_empty() {
        return Err(CompareError::NoOutput {
            origin: record.origin.clone(),
            vehicle: vehicle.name.clone(),
            outputs: vehicle.outputs.iter().map(|o| o.name.clone()).collect(),
            available: record.names(),
        });
    }
    let steps: Vec<f64> = record.time.windows(2).map(|t| t[1] - t[0]).collect();
    let own = median(&steps);
    let period_s = even.or(options.period_s).unwrap_or(own);
    let points =
        if own > 0.0 { (record.duration() / period_s * (1.0 + 1e-12)).floor() as usize + 1 } else { 0 };
    if points < 16 {
        return Err(CompareError::TooShort { origin: record.origin.clone(), points, period_s });
    }
    if points > 50_000_000 {
        return Err(CompareError::TooFine { duration_s: record.duration(), period_s });
    }
    let start_s = record.time[0];
    let t: Vec<f64> = (0..points).map(|k| start_s + k as f64 * period_s).collect();
    let coarser = period_s > 1.5 * own;
    let columns: Vec<Vec<f64>> = inputs.iter().map(|s| held(&record.time, &s.values, &t, period_s)).collect();
    let measured = found.iter().map(|&i| {
        // The filter above found the signal.
        let values = record.get(&vehicle.outputs[i].name).map_or(&[][..], |s| &s.values);
        if coarser {
            averaged(&record.time, values, &t, period_s, own)
        } else {
            interpolated(&record.time, values, &t, own)
        }
    });
    Ok(Grid {
        start_s,
        period_s,
        inputs: (0..points).flat_map(|k| columns.iter().map(move |c| c[k])).collect(),
        measured: measured.collect(),
        outputs: found,
        t,
        uneven: steps.iter().filter(|s| (*s - own).abs() > 0.5 * own).count() as f64
            / steps.len().max(1) as f64,
    })
}

/// The period of a clock whose stamps are even but for rounding; `None` when there are gaps or jitter.
fn even_period(time: &[f64]) -> Option<f64> {
    let (first, last) = (time.first()?, time.last()?);
    let mean = (last - first) / (time.len().checked_sub(1).filter(|n| *n > 0)? as f64);
    // A clock is given with some six digits: 0.0016384 s, not 0.00163840001.
    let digits = 10f64.powi(7 - mean.log10().ceil() as i32);
    let rounded = (mean * digits).round() / digits;
    let tolerance = 0.25 * mean;
    let even =
        |period: f64| time.iter().enumerate().all(|(k, t)| (t - first - k as f64 * period).abs() < tolerance);
    [rounded, mean].into_iter().find(|p| even(*p))
}

/// Puts a record on an exactly even clock.
fn straighten(record: &mut Record, period_s: f64) {
    if let Some(first) = record.time.first().copied() {
        record.time.iter_mut().enumerate().for_each(|(k, t)| *t = first + k as f64 * period_s);
    }
}

/// What a held signal is on average over `[t, t + period)`: exact for a zero-order hold. Before the first value: 0.
fn held(time: &[f64], values: &[f64], t: &[f64], period_s: f64) -> Vec<f64> {
    let known: Vec<(f64, f64)> =
        time.iter().zip(values).filter(|(_, v)| v.is_finite()).map(|(t, v)| (*t, *v)).collect();
    let mut at = 0;
    // A stamp that is off by rounding belongs to its grid point.
    let slack = 1e-6 * period_s;
    t.iter()
        .map(|&start| {
            while at < known.len() && known[at].0 <= start + slack {
                at += 1;
            }
            let mut value = if at == 0 { 0.0 } else { known[at - 1].1 };
            let (mut sum, mut from) = (0.0, start);
            let mut next = at;
            while next < known.len() && known[next].0 < start + period_s - slack {
                sum += value * (known[next].0 - from);
                (from, value) = known[next];
                next += 1;
            }
            (sum + value * (start + period_s - from)) / period_s
        })
        .collect()
}

/// Linear interpolation; the value itself on a point of the record; NaN across more than one missing point.
fn interpolated(time: &[f64], values: &[f64], t: &[f64], own: f64) -> Vec<f64> {
    let mut at = 0;
    t.iter()
        .map(|&t| {
            while at + 1 < time.len() && time[at + 1] <= t + 1e-6 * own {
                at += 1;
            }
            let near = (time[at] - t).abs() <= 1e-6 * own;
            if near || at + 1 == time.len() {
                return if near { values[at] } else { f64::NAN };
            }
            let gap = time[at + 1] - time[at];
            if gap > 2.5 * own {
                return f64::NAN;
            }
            values[at] + (values[at + 1] - values[at]) * (t - time[at]) / gap
        })
        .collect()
}

/// Mean over one period about each point: keeps what is faster than the new grid from folding into it. Every sample
/// stands for one step of the record about it and counts with the part of that step inside the period, so that
/// the mean is not early or late where samples lie on the edge.
fn averaged(time: &[f64], values: &[f64], t: &[f64], period_s: f64, own: f64) -> Vec<f64> {
    let reach = 0.5 * (period_s + own);
    t.iter()
        .map(|&t| {
            let from = time.partition_point(|v| *v <= t - reach);
            let until = time.partition_point(|v| *v < t + reach);
            let (mut sum, mut weights) = (0.0, 0.0);
            for (at, value) in time[from..until].iter().zip(&values[from..until]) {
                let weight = (reach - (at - t).abs()).min(own);
                if value.is_finite() && weight > 1e-6 * own {
                    sum += weight * value;
                    weights += weight;
                }
            }
            if weights > 0.0 { sum / weights } else { f64::NAN }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_held_input_keeps_its_integral() {
        let time: Vec<f64> = (0..100).map(|i| i as f64 * 0.01).collect();
        let u: Vec<f64> = (0..100).map(|i| f64::from(i % 7)).collect();
        let t: Vec<f64> = (0..20).map(|i| i as f64 * 0.05).collect();
        let coarse = held(&time, &u, &t, 0.05);
        let (a, b) = (coarse.iter().sum::<f64>() * 0.05, u.iter().sum::<f64>() * 0.01);
        assert!((a - b).abs() < 1e-9, "{a} {b}");
        assert_eq!(held(&time, &u, &time, 0.01).iter().map(|v| v.round()).collect::<Vec<_>>(), u);
    }

    #[test]
    fn a_clock_that_was_rounded_is_even_and_one_with_a_gap_is_not() {
        let rounded: Vec<f64> = (0..2000).map(|k| (k as f64 * 0.0016384 * 1e4).round() / 1e4).collect();
        assert!((even_period(&rounded).unwrap() - 0.0016384).abs() < 1e-7);
        let mut gap = rounded.clone();
        gap[1000..].iter_mut().for_each(|t| *t += 0.1);
        assert_eq!(even_period(&gap), None);
    }

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

    #[test]
    fn outputs_are_interpolated_but_not_across_gaps() {
        let time = [0.0, 0.1, 0.2, 0.9, 1.0];
        let y = [0.0, 1.0, 2.0, 9.0, 10.0];
        let r = interpolated(&time, &y, &[0.05, 0.1, 0.5, 0.95, 1.0, 1.1], 0.1);
        assert!((r[0] - 0.5).abs() < 1e-12 && r[1] == 1.0 && r[2].is_nan());
        assert!((r[3] - 9.5).abs() < 1e-9 && r[4] == 10.0 && r[5].is_nan());
    }

    #[test]
    fn an_average_is_neither_early_nor_late() {
        let time: Vec<f64> = (0..1000).map(|i| i as f64 * 0.01).collect();
        let line: Vec<f64> = time.iter().map(|t| 3.0 * t).collect();
        let t: Vec<f64> = (1..20).map(|i| i as f64 * 0.4).collect();
        for period_s in [0.02, 0.03, 0.04, 0.05] {
            for (mean, t) in averaged(&time, &line, &t, period_s, 0.01).iter().zip(&t) {
                assert!((mean - 3.0 * t).abs() < 1e-9, "{period_s} {t}: {mean}");
            }
        }
    }
}
