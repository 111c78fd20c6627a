//! Resampling of control signals, which are held from sample to sample.

use super::clock::{Clock, TOLERANCE};

/// Mean of a held signal from each point of a clock to the next, which moves a vehicle as far as the signal does.
/// Values that are not finite are skipped. The value before the first is `before`; the last one holds forever.
pub fn held(time: &[f64], values: &[f64], clock: &Clock, before: f64) -> Vec<f64> {
    let known: Vec<(f64, f64)> =
        time.iter().zip(values).filter(|(_, v)| v.is_finite()).map(|(t, v)| (*t, *v)).collect();
    // A stamp with a rounding error belongs to its point of the clock.
    let slack = TOLERANCE * clock.period;
    let mut at = 0;
    (0..clock.points)
        .map(|k| {
            let start = clock.at(k);
            let end = start + clock.period;
            while known.get(at).is_some_and(|(t, _)| *t <= start + slack) {
                at += 1;
            }
            let value = if at == 0 { before } else { known[at - 1].1 };
            let changes = known[at..].iter().take_while(|(t, _)| *t < end - slack);
            mean(value, start, end, changes)
        })
        .collect()
}

/// Mean from `start` to `end` of a signal that begins with `value` and changes at the given times.
fn mean<'c>(value: f64, start: f64, end: f64, changes: impl Iterator<Item = &'c (f64, f64)>) -> f64 {
    let (mut value, mut from, mut sum) = (value, start, 0.0);
    for (at, next) in changes {
        sum += value * (at - from);
        (from, value) = (*at, *next);
    }
    // A constant value is returned exactly, without rounding errors.
    if from == start { value } else { (sum + value * (end - from)) / (end - start) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every(period: f64, points: usize) -> Clock {
        Clock { start: 0.0, period, points }
    }

    #[test]
    fn a_held_signal_keeps_its_integral() {
        let time: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.01).collect();
        let u: Vec<f64> = (0..100).map(|i| f64::from(i % 7)).collect();
        let coarse = held(&time, &u, &every(0.05, 20), 0.0);
        let (a, b) = (coarse.iter().sum::<f64>() * 0.05, u.iter().sum::<f64>() * 0.01);
        assert!((a - b).abs() < 1e-9, "{a} {b}");
        assert_eq!(held(&time, &u, &every(0.01, 100), 0.0), u);
    }

    #[test]
    fn what_is_before_the_first_value_is_said_by_the_caller() {
        let found = held(&[0.0, 0.15, 0.3], &[f64::NAN, 2.0, 4.0], &every(0.1, 5), 1.0);
        let expected = [1.0, 1.5, 2.0, 4.0, 4.0];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
    }
}
