//! Rests: a sensor that stays at one value because nothing moves, and not because it is at a limit.

use whirlstand_logs::stats::quantile;

use crate::data::record::{Channel, Data};
use crate::thresholds::{FAST_SHARE, MIN_HELD_SAMPLES, SLOW_ARRIVAL};

/// The samples of a channel that repeat a value because nothing moves. A sensor at a limit hides a motion: it arrives there at
/// some speed. What it repeats from the beginning of a record on shows no arrival. Later it rests where it comes to the
/// value slowly, and no command and no other sensor changes for half of the time for which it stays.
pub fn at_rest(data: &Data, index: usize) -> Vec<bool> {
    let channel = &data.channels[index];
    // What is missing is taken for what was measured before.
    let last_known = |last: &mut f64, value: &f64| {
        if !value.is_nan() {
            *last = *value;
        }
        Some(*last)
    };
    let values: Vec<f64> = channel.values.iter().scan(f64::NAN, last_known).collect();
    let begins: Vec<usize> = data.parts(channel).map(|part| part.start).collect();
    let steps: Vec<f64> = values.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|step| *step > 0.0).collect();
    let slow = if steps.is_empty() { 0.0 } else { SLOW_ARRIVAL * quantile(&steps, FAST_SHARE) };
    let moved = moved_before(data, index);
    let mut resting = vec![false; values.len()];
    let mut from = 0;
    for run in values.chunk_by(|a, b| a == b) {
        let (first, last) = (from, from + run.len() - 1);
        from += run.len();
        let at_beginning = begins.binary_search(&first).is_ok();
        // A limit cuts the last step of the arrival short, not the one before.
        let step_to = |to: usize| if to > 0 { (values[to] - values[to - 1]).abs() } else { 0.0 };
        let arrives_slowly = || step_to(first).max(step_to(first.saturating_sub(1))) <= slow;
        // A motor follows its command late.
        let moved_at = |sample: usize| moved.get(channel.step(sample));
        let still = || moved_at(first + run.len() / 2) == moved_at(first);
        if run.len() >= MIN_HELD_SAMPLES && (at_beginning || still() && arrives_slowly()) {
            resting[first..=last].fill(true);
        }
    }
    resting
}

/// For each step, at how many steps up to it a command or a sensor other than this one had changed.
fn moved_before(data: &Data, index: usize) -> Vec<usize> {
    let mut changes = vec![false; data.steps];
    let (m, inputs) = (data.m, &data.inputs);
    for step in 1..data.steps {
        changes[step] = inputs[(step - 1) * m..step * m] != inputs[step * m..(step + 1) * m];
    }
    let others = data.channels.iter().enumerate().filter(|(other, _)| *other != index);
    for (_, Channel { values, first, stride, .. }) in others {
        for k in 1..values.len() {
            let step = first + k * stride;
            changes[step.min(data.steps - 1)] |=
                values[k] != values[k - 1] && !values[k].is_nan() && !values[k - 1].is_nan();
        }
    }
    let count = |sum: &mut usize, changes: bool| {
        *sum += usize::from(changes);
        Some(*sum)
    };
    changes.into_iter().scan(0, count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_logs::Record;
    use whirlstand_vehicle::{Kind, Vehicle};

    use crate::data::sample_effects::measured_effects;

    /// A motor that is switched on and off, with a tachometer that shows multiples of a step from `least` to `most`.
    fn motor(least: f64, most: f64) -> (Vehicle, Data) {
        let text = "A = [[-4.0]]\nB = [[4.0]]\nC = [[1.0]]\nstates = [{ name = \"w\" }]\ninputs = [{ name = \"u\" }]\n\
                    outputs = [{ name = \"speed\" }]\n";
        let vehicle = Vehicle::parse(text, "motor.toml").unwrap();
        let time: Vec<f64> = (0..3000).map(|k| k as f64 * 0.01).collect();
        let (mut w, mut shown, mut commands) = (0.0, Vec::new(), Vec::new());
        for k in 0..3000 {
            let u = if k > 100 && k / 500 % 2 == 0 { 100.0 } else { 0.0 };
            shown.push((f64::round(w / 0.5) * 0.5).clamp(least, most));
            commands.push(u);
            w += 0.04 * (u - w);
        }
        let mut record = Record::new("motor.csv", time).unwrap();
        record.push("u", "", commands).unwrap();
        record.push("speed", "", shown).unwrap();
        let data = Data::new(&record, &vehicle, None).unwrap();
        (vehicle, data)
    }

    /// A motor that stands still was a sensor at its lower limit.
    #[test]
    fn a_motor_at_rest_is_no_sensor_at_a_limit() {
        let limits = |(vehicle, mut data): (Vehicle, Data)| {
            let found = measured_effects(&mut data, &vehicle);
            let clipped = found.into_iter().find(|effect| effect.kind == Kind::OutputSaturation)?;
            Some(["lower", "upper"].map(|name| clipped.parameters[name].0))
        };
        assert_eq!(limits(motor(-1e9, 1e9)), None);
        let upper = limits(motor(-1e9, 60.0)).unwrap();
        assert!(upper[1] == 60.0 && upper[0] < -100.0, "{upper:?}");
        let lower = limits(motor(40.0, 1e9)).unwrap();
        assert!(lower[0] == 40.0 && lower[1] > 200.0, "{lower:?}");
    }
}
