//! Gaps in a record: the longest gap through which a prediction may continue.

use std::f64::consts::PI;

use whirlstand_logs::Record;
use whirlstand_logs::stats::{mean, rms};
use whirlstand_vehicle::Vehicle;

use crate::thresholds::{BRIDGED_RECORD_SHARE, BRIDGED_TIME_CONSTANT_SHARE, GAP_STEPS};
use crate::vehicle_poles::time_constants_s;

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
    let fastest = time_constants_s(vehicle).into_iter().fold(f64::INFINITY, f64::min);
    let slow = (BRIDGED_TIME_CONSTANT_SHARE * fastest).min(BRIDGED_RECORD_SHARE * record.duration());
    let known = if half_period.is_finite() { half_period } else { record.duration() };
    known.max(slow).max(GAP_STEPS * period_s)
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
