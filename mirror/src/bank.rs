//! A bank of cumulative-sum tests on whitened innovations: whether the prediction has become wrong, and since
//! when.
//!
//! Each test accumulates the log-likelihood ratio of one change against no change, bounded below by zero
//! (CUSUM; Page 1954; Basseville and Nikiforov 1993, 2.2). The changes are mean shifts of several sizes to
//! either side, increases of the standard deviation by several factors, and a repeating value; the
//! [tones](Tones) are tested separately. The sizes are so close that a change between two of them costs
//! little power (2.2.3 there, on unknown sizes).

use crate::run_length::{mean_threshold, variance_threshold};
use crate::tones::Tones;

/// Mean shifts in standard deviations of an innovation, a factor of four apart: a shift between two of them
/// is detected with four fifths of the information that a test of its own size would have.
const MEANS: [f64; 4] = [0.05, 0.2, 0.8, 3.2];

/// Factors by which the standard deviation increases.
const SPREADS: [f64; 2] = [1.3, 3.0];

/// Number of tests per output, without tones.
const TESTS: usize = 2 * MEANS.len() + SPREADS.len() + 1;

/// Upper limit of the log-likelihood ratio of one repeated value: a sensor without rounding never repeats a
/// value, but one repetition must not give certainty.
const LARGEST_REPEAT: f64 = 12.0;

/// Kind of change that a cumulative sum tests for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// The mean has changed.
    Mean,
    /// The variance has increased.
    Spread,
    /// A value repeats itself.
    Repeat,
    /// A tone has appeared.
    Tone,
}

/// The alarm of a test whose sum exceeds its threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alarm {
    /// Index of the output.
    pub output: usize,
    /// Kind of change.
    pub change: Change,
    /// First step after the sum was last zero: the most likely onset of the change.
    pub since: u64,
    /// Log-likelihood ratio of the change against no change.
    pub evidence: f64,
}

#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    value: f64,
    since: u64,
}

impl Sum {
    /// Adds a log-likelihood ratio to the sum; returns whether the sum exceeds the threshold.
    #[inline]
    fn add(&mut self, ratio: f64, threshold: f64, step: u64) -> bool {
        self.value += ratio;
        if self.value <= 0.0 {
            (self.value, self.since) = (0.0, step + 1);
        }
        self.value > threshold
    }
}

/// All tests of all outputs.
#[derive(Debug, Clone)]
pub struct Bank {
    sums: Vec<[Sum; TESTS]>,
    means: [f64; MEANS.len()],
    spread: f64,
    /// Log-likelihood ratios per output for a repeated value and for a new one.
    repeats: Vec<(f64, f64)>,
    last: Vec<f64>,
    tones: Tones,
}

impl Bank {
    /// `repeats`: for each output, the probability without any change that a value equals the one before. The
    /// whole bank raises one false alarm in `steps` on average.
    pub fn new(repeats: &[f64], steps: f64) -> Self {
        let count = repeats.len();
        let each = steps * (count * (TESTS + Tones::TESTS)) as f64;
        Self {
            sums: vec![[Sum::default(); TESTS]; count],
            means: MEANS.map(|size| mean_threshold(size, each)),
            spread: variance_threshold(each),
            // The alternative hypothesis is that half of the values repeat; the null hypothesis is the share
            // without a change.
            repeats: repeats.iter().map(|p| repeat_ratios(*p)).collect(),
            last: vec![f64::NAN; count],
            tones: Tones::new(count, variance_threshold(each)),
        }
    }

    /// Tests this output no longer for repeated values, because it is rounded.
    pub fn expect_repeats(&mut self, output: usize) {
        self.repeats[output] = repeat_ratios(1.0);
    }

    /// Resets all tests at a step.
    pub fn restart(&mut self, step: u64) {
        self.sums.as_flattened_mut().fill(Sum { value: 0.0, since: step });
        self.tones.restart(step);
    }

    /// Processes the whitened innovations and values of a step, for the outputs in `fresh`. Returns the alarm
    /// with the largest ratio of sum to threshold, if any.
    pub fn step(&mut self, step: u64, whitened: &[f64], y: &[f64], fresh: u64) -> Option<Alarm> {
        let mut worst: Option<(f64, Alarm)> = None;
        for (output, sums) in self.sums.iter_mut().enumerate() {
            if fresh >> output & 1 == 0 {
                continue;
            }
            let e = whitened[output];
            let mut note = |sum: Sum, threshold: f64, change: Change| {
                let beyond = sum.value / threshold;
                if worst.is_none_or(|(most, _)| beyond > most) {
                    worst = Some((beyond, Alarm { output, change, since: sum.since, evidence: sum.value }));
                }
            };
            for (k, (&size, &threshold)) in MEANS.iter().zip(&self.means).enumerate() {
                for (sum, e) in sums[2 * k..2 * k + 2].iter_mut().zip([e, -e]) {
                    if sum.add(size * (e - 0.5 * size), threshold, step) {
                        note(*sum, threshold, Change::Mean);
                    }
                }
            }
            for (k, factor) in SPREADS.iter().enumerate() {
                let ratio = 0.5 * e * e * (1.0 - 1.0 / (factor * factor)) - factor.ln();
                let sum = &mut sums[2 * MEANS.len() + k];
                if sum.add(ratio, self.spread, step) {
                    note(*sum, self.spread, Change::Spread);
                }
            }
            let (again, other) = self.repeats[output];
            let ratio = if y[output] == self.last[output] { again } else { other };
            self.last[output] = y[output];
            if again > 0.0 && sums[TESTS - 1].add(ratio, self.spread, step) {
                note(sums[TESTS - 1], self.spread, Change::Repeat);
            }
        }
        if let Some((beyond, output, since)) = self.tones.step(step, whitened)
            && worst.is_none_or(|(most, _)| beyond > most)
        {
            let evidence = beyond * self.spread;
            worst = Some((beyond, Alarm { output, change: Change::Tone, since, evidence }));
        }
        worst.map(|(_, alarm)| alarm)
    }
}

/// Log-likelihood ratios for a repeated value and for a new one, where values repeat with probability `p`
/// without a change.
fn repeat_ratios(p: f64) -> (f64, f64) {
    ((0.5 / p.max(1e-12)).ln().min(LARGEST_REPEAT), (0.5 / (1.0 - p.min(0.999))).ln())
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_vehicle::Stream;

    #[test]
    fn what_changes_is_said_with_its_beginning_and_nothing_before() {
        let mut stream = Stream::new(3, "bank");
        for (change, mean, spread) in
            [(Change::Mean, 1.0, 1.0), (Change::Mean, -0.3, 1.0), (Change::Spread, 0.0, 1.8)]
        {
            let mut bank = Bank::new(&[0.0, 0.0], 1e7);
            for step in 0..5000 {
                let y = [stream.normal(), stream.normal()];
                assert_eq!(bank.step(step, &y, &y, 3), None, "step {step}");
            }
            let alarm = (5000..8000).find_map(|step| {
                let y = [stream.normal(), mean + spread * stream.normal()];
                bank.step(step, &y, &y, 3).map(|alarm| (step, alarm))
            });
            let (step, alarm) = alarm.unwrap();
            assert_eq!((alarm.output, alarm.change), (1, change));
            assert!(alarm.since.abs_diff(5000) < 150 && step < 6000, "{alarm:?} at {step}");
        }
    }

    #[test]
    fn a_sensor_that_stands_still_is_told_in_a_few_steps() {
        let mut bank = Bank::new(&[0.0], 1e9);
        let alarm = (0..20u64).find_map(|step| {
            let y = [if step < 10 { step as f64 * 0.01 } else { 0.1 }];
            bank.step(step, &[0.0], &y, 1).map(|alarm| (step, alarm))
        });
        let (step, alarm) = alarm.unwrap();
        assert!(step < 15 && alarm.change == Change::Repeat, "{step} {alarm:?}");
    }
}
