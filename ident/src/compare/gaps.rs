//! Gaps in a record: the longest gap through which a prediction may continue, and the inputs meanwhile.

use std::collections::BTreeSet;
use std::f64::consts::PI;

use nalgebra::DMatrix;
use whirlstand_logs::stats::{mean, rms, white_noise_std};
use whirlstand_logs::{LONGEST_BRIDGED, Record, gaps, median_interval};
use whirlstand_vehicle::{Vehicle, discretise, finite_horizon_gramian};

/// Gaps of one length that are tried, evenly spread over the record.
const TRIED_GAPS: usize = 200;
/// Steps for each sample of a record beyond which most of it is missing, and no gap in it is bridged.
const MOST_STEPS_PER_SAMPLE: f64 = 10.0;

/// The longest gap through which a prediction may continue, s. Missing samples cost nothing but their own
/// information (a filter predicts through them), as long as the commands in the gap are known well enough. How well a
/// straight line tells them, the rest of the record shows: where it has commands, the line between the ends of a gap
/// misses them by so much, and the error of the vehicle's outputs that follows, in units of their noise and summed over all
/// samples after the gap, is what the prediction would be wrong by on purpose. A line is too slow at every gap, so that the
/// errors of all gaps add up to one effect. The prediction continues while all of them together cost no more than a cut at
/// one of them, which estimates a new initial state: one such unit for each state (Akaike 1974).
///
/// A vehicle without a response, of which nothing is known yet, continues as long as the neighbours of a gap determine the
/// commands in it at all, half a period of their band apart (Shannon 1949), the band by the frequency with which they cross
/// their mean (Rice 1944).
pub fn bridged_s(record: &Record, vehicle: &Vehicle, period_s: f64) -> f64 {
    let least = LONGEST_BRIDGED * period_s;
    if vehicle.b.iter().chain(vehicle.d.iter()).all(|gain| *gain == 0.0) {
        let inputs = vehicle.inputs.iter().filter_map(|i| record.get(&i.name));
        let half_period = inputs.map(|signal| half_period_s(&record.time, &signal.values));
        return half_period.fold(f64::INFINITY, f64::min).clamp(least, record.duration().max(least));
    }
    let Some(response) = Response::new(record, vehicle, period_s) else { return least };
    let steps_since = |from: f64, t: f64| ((t - from) / period_s).round() as usize;
    // Rows that are missing, and rows without a command.
    let of_rows = record.time.windows(2).map(|w| (w[0], w[1]));
    let commands = vehicle.inputs.iter().filter_map(|i| record.get(&i.name));
    let of_commands = commands.flat_map(|signal| gaps(&known(&record.time, &signal.values).0));
    let missing: BTreeSet<(usize, usize)> = of_rows
        .chain(of_commands)
        .filter(|(from, to)| to - from > least)
        .map(|(from, to)| (steps_since(from, to), steps_since(record.time[0], from)))
        .collect();
    let gaps: Vec<(usize, usize)> = missing.into_iter().collect();
    let (mut bridged, mut cost) = (least, 0.0);
    for same in gaps.chunk_by(|a, b| a.0 == b.0) {
        cost += response.cost(same);
        if cost > vehicle.states.len() as f64 {
            break;
        }
        bridged = (same[0].0 as f64 + 0.5) * period_s;
    }
    bridged
}

/// The recorded commands, and how errors of them move the outputs.
struct Response {
    /// Commands in steps of the record; NaN where there are none.
    inputs: Vec<Vec<f64>>,
    transition: DMatrix<f64>,
    input: DMatrix<f64>,
    /// Sum over all samples of the squared error of the outputs in units of their noise, as a form of the state's error at
    /// the first of them.
    visible: DMatrix<f64>,
}

impl Response {
    fn new(record: &Record, vehicle: &Vehicle, period_s: f64) -> Option<Self> {
        // Of a clock that was set meanwhile, the steps between would not fit into memory.
        if record.duration() / period_s > MOST_STEPS_PER_SAMPLE * record.len() as f64 {
            return None;
        }
        let (transition, input) = discretise(&vehicle.a, &vehicle.b, period_s).ok()?;
        let mut weighted = vehicle.c.transpose();
        for (i, output) in vehicle.outputs.iter().enumerate() {
            let measured = record.get(&output.name).map_or(0.0, |signal| white_noise_std(&signal.values));
            let noise = if output.noise > 0.0 { output.noise } else { measured };
            let seen = record.get(&output.name).is_some() && noise > 0.0;
            weighted.column_mut(i).scale_mut(if seen { 1.0 / noise } else { 0.0 });
        }
        let slowest = vehicle.time_constants_s().into_iter().fold(period_s, f64::max).min(record.duration());
        let weight = &weighted * weighted.transpose();
        let visible = finite_horizon_gramian(&vehicle.a.transpose(), &weight, slowest).ok()? / period_s;
        let inputs = vehicle.inputs.iter().filter_map(|i| record.get(&i.name));
        Some(Self {
            inputs: inputs.map(|s| in_steps(&record.time, &s.values, period_s)).collect(),
            transition,
            input,
            visible,
        })
    }

    /// Expected squared error that follows some gaps of one length, given by it and their first steps. It is the mean over
    /// gaps of that length where the commands are known; for a gap across which they changed more than the changes just
    /// before and after it foretell, as where they jumped, as many times more as the square of that surprise exceeds its
    /// mean.
    fn cost(&self, gaps: &[(usize, usize)]) -> f64 {
        let Some((steps, _)) = gaps.first().copied() else { return 0.0 };
        let length = self.inputs.iter().map(Vec::len).min().unwrap_or(0);
        let last = length.saturating_sub(steps + 1);
        let told =
            |from: usize| self.inputs.iter().all(|u| u[from..=from + steps].iter().all(|v| v.is_finite()));
        let tried: Vec<usize> =
            (0..last).step_by((last / TRIED_GAPS).max(1)).filter(|from| told(*from)).collect();
        if tried.is_empty() {
            return f64::INFINITY;
        }
        let mean_of = |of: &dyn Fn(usize) -> f64| {
            let values = tried.iter().map(|from| of(*from)).filter(|v| v.is_finite()).collect::<Vec<_>>();
            mean(&values)
        };
        let usual = mean_of(&|from| self.error(from, steps));
        let surprises: Vec<f64> =
            self.inputs.iter().map(|u| mean_of(&|from| surprise(u, from, steps).powi(2))).collect();
        let times = |from: usize| {
            let of_input = |(u, usual): (&Vec<f64>, &f64)| surprise(u, from, steps).powi(2) / usual;
            self.inputs.iter().zip(&surprises).map(of_input).fold(1.0, f64::max)
        };
        // Commands that jump at no other place say nothing about this one.
        let cost = |from: usize| usual * times(from);
        gaps.iter()
            .map(|(_, from)| cost(*from))
            .map(|cost| if cost.is_nan() { f64::INFINITY } else { cost })
            .sum()
    }

    /// The squared error that would follow a gap in known commands.
    fn error(&self, from: usize, steps: usize) -> f64 {
        let mut state = DMatrix::zeros(self.transition.nrows(), 1);
        for k in 1..steps {
            let missed = self.inputs.iter().map(|u| {
                let (first, last) = (u[from], u[from + steps]);
                u[from + k] - first - (last - first) * k as f64 / steps as f64
            });
            let missed = DMatrix::from_iterator(self.inputs.len(), 1, missed);
            state = &self.transition * state + &self.input * missed;
        }
        state.dot(&(&self.visible * &state))
    }
}

/// Change of a signal across a gap beyond the mean of its changes over as long before and after; NaN where it has no values.
fn surprise(u: &[f64], from: usize, steps: usize) -> f64 {
    let at = |step: Option<usize>| step.and_then(|step| u.get(step)).copied().unwrap_or(f64::NAN);
    let (first, last) = (at(Some(from)), at(Some(from + steps)));
    let (before, after) = (at(from.checked_sub(steps)), at(Some(from + 2 * steps)));
    last - first - 0.5 * ((first - before) + (after - last))
}

/// A signal in steps of a record, on straight lines where it has no values that it usually does not have: between those of
/// a slower topic, or of a clock that jitters. NaN in its gaps.
fn in_steps(time: &[f64], values: &[f64], period_s: f64) -> Vec<f64> {
    let (Some(first), Some(last)) = (time.first(), time.last()) else { return Vec::new() };
    let step = |t: f64| ((t - first) / period_s).round() as usize;
    let mut steps = vec![f64::NAN; step(*last) + 1];
    let (time, values) = known(time, values);
    let usual = LONGEST_BRIDGED * median_interval(&time).unwrap_or(0.0).max(period_s);
    for (t, v) in time.windows(2).zip(values.windows(2)).filter(|(t, _)| t[1] - t[0] <= usual) {
        let (from, to) = (step(t[0]), step(t[1]));
        for (k, value) in steps[from..=to].iter_mut().enumerate() {
            *value = v[0] + (v[1] - v[0]) * k as f64 / (to - from).max(1) as f64;
        }
    }
    steps
}

/// The times at which a signal has a value, and the values.
fn known(time: &[f64], values: &[f64]) -> (Vec<f64>, Vec<f64>) {
    time.iter().zip(values).filter(|(_, v)| v.is_finite()).map(|(t, v)| (*t, *v)).unzip()
}

/// The known samples of an input, with further ones on a straight line through every gap of a regular signal that is not
/// longer than `longest_s`. That is the mean of what may have been sent meanwhile, for a signal that moves from sample to
/// sample as for one that jumped once at an unknown time; the last value before the gap would be off by the whole change.
pub fn input_through_gaps(time: &[f64], values: &[f64], longest_s: f64) -> (Vec<f64>, Vec<f64>) {
    let (time, values) = known(time, values);
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
    let (time, values) = known(time, values);
    let middle = mean(&values);
    let size = rms(&values.iter().map(|v| v - middle).collect::<Vec<_>>());
    let both = time.windows(2).zip(values.windows(2)).filter(|(t, _)| t[1] > t[0]);
    let slope = rms(&both.map(|(t, v)| (v[1] - v[0]) / (t[1] - t[0])).collect::<Vec<_>>());
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

    /// A roll axis of 100 Hz, from which half a second is missing: the longest gap that is bridged under a stick of a
    /// frequency and a noise of the gyroscope.
    fn bridged(frequency_hz: f64, noise: f64, missing_s: f64) -> f64 {
        let text = format!(
            "name = 'axis'\nA = [[-2.0]]\nB = [[5.0]]\ninputs = [{{ name = 'u' }}]\n\
             states = [{{ name = 'rate' }}]\noutputs = [{{ name = 'rate', noise = {noise} }}]\n"
        );
        let vehicle = Vehicle::parse(&text, "axis.toml").unwrap();
        let time: Vec<f64> = (0..4000)
            .map(|k| f64::from(k) * 0.01)
            .filter(|t| !(10.0..10.0 + missing_s).contains(t))
            .collect();
        let mut record = Record::new("axis", time.clone()).unwrap();
        record.push("u", "", time.iter().map(|t| (2.0 * PI * frequency_hz * t).sin()).collect()).unwrap();
        record.push("rate", "", time.iter().map(|t| t.cos()).collect()).unwrap();
        bridged_s(&record, &vehicle, 0.01)
    }

    /// A stick that is recorded at every fifth row, and not at all for half a second: its rows go on.
    #[test]
    fn commands_that_pause_are_gaps_of_a_slower_topic() {
        let text = "name = 'axis'\nA = [[-2.0]]\nB = [[5.0]]\ninputs = [{ name = 'u' }]\n\
                    states = [{ name = 'rate' }]\noutputs = [{ name = 'rate', noise = 1.0 }]\n";
        let vehicle = Vehicle::parse(text, "axis.toml").unwrap();
        let time: Vec<f64> = (0..4000).map(|k| f64::from(k) * 0.01).collect();
        let recorded = |k: usize| k.is_multiple_of(5) && !(1000..1050).contains(&k);
        let stick = |k: usize| if recorded(k) { (0.4 * PI * time[k]).sin() } else { f64::NAN };
        let mut record = Record::new("axis", time.clone()).unwrap();
        record.push("u", "", (0..4000).map(stick).collect()).unwrap();
        record.push("rate", "", time.iter().map(|t| t.cos()).collect()).unwrap();
        let bridged = bridged_s(&record, &vehicle, 0.01);
        assert!(bridged > 0.5, "{bridged}");
    }

    /// The stick is the same, and its error is within a noise that it stands out of where the noise is small.
    #[test]
    fn a_gap_is_bridged_while_its_commands_move_nothing_beyond_the_noise() {
        assert!(bridged(0.05, 0.05, 0.5) > 0.45, "a slow stick in noise");
        let (quiet, loud) = (bridged(0.2, 0.01, 0.5), bridged(0.2, 1.0, 0.5));
        assert!(quiet < 0.2 && loud > 0.45, "{quiet} {loud}");
        assert!(bridged(0.05, 0.05, 30.0) < 0.2, "longer than all that is known");
        assert!(
            (bridged(1.0, 0.2, 0.02) - LONGEST_BRIDGED * 0.01).abs() < 1e-9,
            "two samples are always bridged"
        );
    }
}
