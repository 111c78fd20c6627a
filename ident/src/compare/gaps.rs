//! Gaps in a record: the longest gap through which a prediction may continue, and the inputs meanwhile.

use std::f64::consts::PI;

use whirlstand_logs::stats::{mean, rms};
use whirlstand_logs::{LONGEST_BRIDGED, Record, gaps, median_interval};
use whirlstand_vehicle::Vehicle;

/// Share of the fastest time constant for which commands may be unknown: their response meanwhile is at most
/// that share of the final response.
const BRIDGED_TIME_CONSTANT_SHARE: f64 = 0.1;
/// Share of the record for which the commands of an integrating vehicle may be unknown. Calibrated.
const BRIDGED_RECORD_SHARE: f64 = 0.01;

/// The longest gap through which a prediction may continue, s. Missing samples cost nothing but their own
/// information (a filter predicts through them), as long as the commands in the gap are known well enough.
/// Commands are known where they change so slowly that their neighbours determine them: samples half a period
/// of the input's band apart do (Shannon 1949), the band by the frequency with which the input crosses its
/// mean (Rice 1944). Commands matter little where the vehicle is slow: in a tenth of its fastest time
/// constant a command moves it by at most a tenth of its final response. An integrator has no such time: for
/// it a hundredth of the record.
pub fn bridged_s(record: &Record, vehicle: &Vehicle, period_s: f64) -> f64 {
    let inputs = vehicle.inputs.iter().filter_map(|i| record.get(&i.name));
    let half_period = inputs.map(|signal| half_period_s(&record.time, &signal.values));
    let half_period = half_period.fold(f64::INFINITY, f64::min);
    let fastest = vehicle.time_constants_s().into_iter().fold(f64::INFINITY, f64::min);
    let slow = (BRIDGED_TIME_CONSTANT_SHARE * fastest).min(BRIDGED_RECORD_SHARE * record.duration());
    let known = if half_period.is_finite() { half_period } else { record.duration() };
    known.max(slow).max(LONGEST_BRIDGED * period_s)
}

/// The known samples of an input, with further ones on a straight line through every gap of a regular signal that is not
/// longer than `longest_s`. That is the mean of what may have been sent meanwhile, for a signal that moves from sample to
/// sample as for one that jumped once at an unknown time; the last value before the gap would be off by the whole change.
pub fn input_through_gaps(time: &[f64], values: &[f64], longest_s: f64) -> (Vec<f64>, Vec<f64>) {
    let known = time.iter().zip(values).filter(|(_, v)| v.is_finite());
    let (time, values): (Vec<f64>, Vec<f64>) = known.map(|(t, v)| (*t, *v)).unzip();
    let step = median_interval(&time).unwrap_or(f64::INFINITY);
    let mut gaps = gaps(&time).into_iter().filter(|(from, to)| to - from <= longest_s).peekable();
    if gaps.peek().is_none() {
        return (time, values);
    }
    let (mut all_times, mut all_values) = (Vec::new(), Vec::new());
    for (k, (t, v)) in time.iter().zip(&values).enumerate() {
        all_times.push(*t);
        all_values.push(*v);
        if let Some((from, to)) = gaps.next_if(|(from, _)| from == t) {
            let missing = ((to - from) / step).round() as usize - 1;
            let share = |i: usize| (i + 1) as f64 / (missing + 1) as f64;
            all_times.extend((0..missing).map(|i| from + share(i) * (to - from)));
            all_values.extend((0..missing).map(|i| v + share(i) * (values[k + 1] - v)));
        }
    }
    (all_times, all_values)
}

/// Half a period of the frequency with which a signal crosses its mean: rms of its slope over 2 pi times its
/// own rms. Infinite for a constant signal.
fn half_period_s(time: &[f64], values: &[f64]) -> f64 {
    let known: Vec<(f64, f64)> =
        time.iter().copied().zip(values.iter().copied()).filter(|(_, v)| v.is_finite()).collect();
    let middle = mean(&known.iter().map(|k| k.1).collect::<Vec<_>>());
    let size = rms(&known.iter().map(|k| k.1 - middle).collect::<Vec<_>>());
    let slopes = known.windows(2).filter(|w| w[1].0 > w[0].0).map(|w| (w[1].1 - w[0].1) / (w[1].0 - w[0].0));
    let slope = rms(&slopes.collect::<Vec<_>>());
    if size > 0.0 && slope > 0.0 { PI * size / slope } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_input_goes_straight_through_a_short_gap() {
        let time: Vec<f64> =
            (0..40).map(f64::from).filter(|t| !(10.0..13.0).contains(t) && *t != 30.0).collect();
        let values: Vec<f64> = time.iter().map(|t| 2.0 * t).collect();
        let whole: Vec<f64> = (0..40).map(f64::from).collect();
        let doubled: Vec<f64> = whole.iter().map(|t| 2.0 * t).collect();
        assert_eq!(input_through_gaps(&time, &values, 5.0), (whole, doubled));
        let (times, _) = input_through_gaps(&time, &values, 3.0);
        assert!(!times.contains(&11.0) && times.contains(&30.0), "the long one is left");
        // A signal that is sent when it changes has no gaps.
        let events = [0.0, 0.1, 3.0, 3.1, 9.0, 9.5];
        assert_eq!(input_through_gaps(&events, &[1.0; 6], 99.0), (events.to_vec(), vec![1.0; 6]));
    }

    #[test]
    fn a_slow_wave_is_known_for_longer_than_a_fast_one() {
        let time: Vec<f64> = (0..2000).map(|k| k as f64 * 0.005).collect();
        for frequency_hz in [0.5, 4.0] {
            let wave: Vec<f64> = time.iter().map(|t| (2.0 * PI * frequency_hz * t).sin()).collect();
            let half = half_period_s(&time, &wave);
            assert!((half * 2.0 * frequency_hz - 1.0).abs() < 0.02, "{half}");
        }
        assert!(half_period_s(&time, &vec![1.0; 2000]).is_infinite());
    }
}
