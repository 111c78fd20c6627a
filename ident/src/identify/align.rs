//! Lags between sensors of different clocks, from the motion that both measure.
//!
//! Where the vehicle file defines one output as the integral of another (an angle and its rate: a row of A
//! with one entry that is not free, and no input), both must show one motion. Rates usually come from a
//! sensor on the same computer as the inputs; the integral, of a camera or a satellite receiver, is the
//! delayed one.

use serde::{Deserialize, Serialize};
use whirlstand_logs::{Record, Series, time_offset};
use whirlstand_vehicle::Vehicle;

/// Longest lag searched for, s.
const LONGEST_S: f64 = 0.5;
/// Length of the moving average of both signals, s.
const SMOOTHING_S: f64 = 0.25;
/// Smallest correlation with which a lag is accepted.
const LEAST_CORRELATION: f64 = 0.7;

/// Lag of an output behind the output that is its derivative.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Lag {
    /// Name of the output that lags.
    pub output: String,
    /// Name of the output that is its derivative.
    pub rate: String,
    /// Lag of `output` behind `rate`, s; positive when `output` is late.
    pub lag_s: f64,
    /// Correlation of the two at that lag.
    pub correlation: f64,
    /// True when the motion determines the lag.
    pub certain: bool,
}

/// The lags in a record; outputs without a derivative among the outputs and outputs that do not move are left
/// out.
pub fn lags(record: &Record, vehicle: &Vehicle) -> Vec<Lag> {
    if record.time_unit != "s" {
        return Vec::new();
    }
    let shown = |state: usize| {
        (0..vehicle.outputs.len()).find(|i| {
            let row = vehicle.c.row(*i);
            row[state] != 0.0
                && row.iter().filter(|c| **c != 0.0).count() == 1
                && record.get(&vehicle.outputs[*i].name).is_some()
        })
    };
    let mut all = Vec::new();
    for i in 0..vehicle.states.len() {
        let Some((j, c)) = vehicle.kinematic_row(i) else { continue };
        let (Some(angle), Some(rate)) = (shown(i), shown(j)) else { continue };
        let sign = (c * vehicle.c[(angle, i)] * vehicle.c[(rate, j)]).signum();
        let [angle, rate] = [angle, rate].map(|o| vehicle.outputs[o].name.clone());
        if let Some(found) = lag(record, &angle, &rate) {
            let correlation = sign * found.correlation;
            all.push(Lag {
                certain: correlation > LEAST_CORRELATION && !found.ambiguous,
                output: angle,
                rate,
                lag_s: found.lag_s,
                correlation,
            });
        }
    }
    all
}

fn lag(record: &Record, angle: &str, rate: &str) -> Option<whirlstand_logs::TimeOffset> {
    let series = record.to_series();
    let of = |name: &str| series.iter().find(|s| s.name == name);
    let (angle, rate) = (smoothed(of(angle)?), smoothed(of(rate)?));
    let slope: Vec<(f64, f64)> =
        angle.windows(3).map(|w| (w[1].0, (w[2].1 - w[0].1) / (w[2].0 - w[0].0))).collect();
    let (slope, rate) = (Series::new("slope", "", slope), Series::new("rate", "", rate));
    time_offset(&rate, &slope, LONGEST_S).ok()
}

/// Centred moving average over [`SMOOTHING_S`], the same for both signals, so that it adds no lag.
fn smoothed(series: &Series) -> Vec<(f64, f64)> {
    let (time, values) = (series.time(), series.values());
    let (mut first, mut end, mut sum) = (0, 0, 0.0);
    time.iter()
        .map(|&t| {
            while end < time.len() && time[end] <= t + 0.5 * SMOOTHING_S {
                sum += values[end];
                end += 1;
            }
            while time[first] < t - 0.5 * SMOOTHING_S {
                sum -= values[first];
                first += 1;
            }
            (t, sum / (end - first).max(1) as f64)
        })
        .collect()
}
