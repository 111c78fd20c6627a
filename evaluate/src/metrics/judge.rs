//! Evaluates the parts of one output's record that follow a step or a disturbance, while the record is read.

use std::collections::VecDeque;

use super::{Recovery, StepResponse, recovery, step_response};

/// Most samples of a part that are evaluated, and so stored: two minutes at 1 kHz, eleven at 200 Hz.
const MOST_SAMPLES: usize = 1 << 17;

/// Time before a part over which the level and spread of the signal are measured, s.
const QUIET_S: f64 = 1.0;

/// A part is averaged over at most this share of its samples to either side.
const SMOOTHED_SHARE: usize = 40;

/// Number of samples between two removals of samples that are no longer needed.
const FORGET_EVERY: usize = 4_096;

/// A part of the record that is to be evaluated; times in s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Part {
    /// From a step of the setpoint to the value `to`.
    Step { at: f64, until: f64, to: f64 },
    /// From the onset of a disturbance.
    Disturbance { at: f64, until: f64 },
}

impl Part {
    /// Start and end, s.
    fn ends(&self) -> (f64, f64) {
        match *self {
            Self::Step { at, until, .. } | Self::Disturbance { at, until } => (at, until),
        }
    }
}

/// Result of the evaluation of a part.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Judgement {
    Step(StepResponse),
    Disturbance(Recovery),
}

/// Evaluates parts of the record of one output. It stores the samples of the present part, at most
/// [`MOST_SAMPLES`], and those around it that the evaluation needs.
#[derive(Debug, Clone)]
pub(crate) struct Judge {
    parts: VecDeque<Part>,
    most_samples: usize,
    t: Vec<f64>,
    y: Vec<f64>,
    wanted: Vec<f64>,
}

/// Samples of one output: times, values and setpoints (NaN where nothing is tracked).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Samples<'a> {
    t: &'a [f64],
    y: &'a [f64],
    wanted: &'a [f64],
    /// Most samples of a part that are evaluated.
    most: usize,
}

impl<'a> Samples<'a> {
    /// A whole record, every slice as long as the others.
    pub fn whole(t: &'a [f64], y: &'a [f64], wanted: &'a [f64]) -> Self {
        Self { t, y, wanted, most: MOST_SAMPLES }
    }

    /// First sample of a part, and the one after its last.
    fn range(&self, part: &Part) -> (usize, usize) {
        let (at, until) = part.ends();
        let from = self.t.partition_point(|t| *t < at - 1e-9);
        let until = self.t.partition_point(|t| *t <= until + 1e-9);
        (from, until.clamp(from, from + self.most))
    }

    /// The result for a part; `None` where it is too short.
    pub fn judge(&self, part: Part) -> Option<Judgement> {
        let (from, end) = self.range(&part);
        let around = (end - from) / SMOOTHED_SHARE + 1;
        let quiet = self.t.partition_point(|t| *t < part.ends().0 - QUIET_S - 1e-9);
        let near = quiet.saturating_sub(around)..(end + around).min(self.t.len());
        let (t, y, wanted) = (&self.t[near.clone()], &self.y[near.clone()], &self.wanted[near]);
        // A part longer than the stored samples is evaluated as far as they go.
        let last = self.t.get(end.wrapping_sub(1)).copied();
        let until = last.filter(|_| end - from == self.most).unwrap_or(part.ends().1);
        match part {
            Part::Step { at, to, .. } => step_response(t, y, at, until, to).map(Judgement::Step),
            Part::Disturbance { at, .. } => {
                let tracked = self.wanted[from..end].iter().all(|w| w.is_finite());
                recovery(t, y, tracked.then_some(wanted), at, until).map(Judgement::Disturbance)
            }
        }
    }
}

impl Judge {
    /// A judge of these parts, which are in the order of their starts.
    pub fn new(parts: impl Into<VecDeque<Part>>) -> Self {
        Self {
            parts: parts.into(),
            most_samples: MOST_SAMPLES,
            t: Vec::new(),
            y: Vec::new(),
            wanted: Vec::new(),
        }
    }

    /// Takes in the next sample: time, value and setpoint (NaN where nothing is tracked). Passes completed results
    /// to `found`.
    pub fn take(&mut self, t: f64, y: f64, wanted: f64, found: &mut impl FnMut(Judgement)) {
        if self.parts.is_empty() {
            return;
        }
        self.t.push(t);
        self.y.push(y);
        self.wanted.push(wanted);
        while let Some(part) = self.parts.front().filter(|part| self.is_whole(part)).copied() {
            self.parts.pop_front();
            self.held().judge(part).into_iter().for_each(&mut *found);
        }
        if self.t.len().is_multiple_of(FORGET_EVERY) {
            self.forget();
        }
    }

    /// Evaluates the parts that the end of the record leaves incomplete.
    pub fn finish(mut self, found: &mut impl FnMut(Judgement)) {
        while let Some(part) = self.parts.pop_front() {
            self.held().judge(part).into_iter().for_each(&mut *found);
        }
    }

    /// The stored samples.
    fn held(&self) -> Samples<'_> {
        Samples { t: &self.t, y: &self.y, wanted: &self.wanted, most: self.most_samples }
    }

    /// Whether the samples of a part are complete, with so many after it that averaging is not affected by
    /// the end.
    fn is_whole(&self, part: &Part) -> bool {
        let last = self.t.last().copied().unwrap_or(f64::NEG_INFINITY);
        let (at, until) = part.ends();
        if last <= at || last <= until + 1e-9 && self.t.len() < self.most_samples {
            return false;
        }
        let (from, end) = self.held().range(part);
        let complete = last > until + 1e-9 || end - from == self.most_samples;
        complete && self.t.len() > end + (end - from) / SMOOTHED_SHARE
    }

    /// Removes the samples that no later part needs.
    fn forget(&mut self) {
        let now = self.t.last().copied().unwrap_or(0.0);
        let next = self.parts.front().map_or(now, |part| part.ends().0.min(now));
        let quiet = self.t.partition_point(|t| *t < next - QUIET_S - 1e-9);
        let unused = quiet.saturating_sub(self.most_samples / SMOOTHED_SHARE + 1);
        if 4 * unused > self.t.len() {
            self.t.drain(..unused);
            self.y.drain(..unused);
            self.wanted.drain(..unused);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_test_harness::noise;

    /// Steps every 20 s of a first-order lag with noise.
    fn record(seconds: usize) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let n = seconds * 100;
        let t: Vec<f64> = (0..n).map(|i| i as f64 * 0.01).collect();
        let wanted: Vec<f64> = t.iter().map(|t| f64::from((t / 20.0) as u32 % 2)).collect();
        let mut y = 0.0;
        let follow = |w: &f64| {
            y += 0.02 * (w - y);
            y
        };
        let clean: Vec<f64> = wanted.iter().map(follow).collect();
        (t, clean.iter().zip(noise(n, 5)).map(|(y, e)| y + 0.01 * e).collect(), wanted)
    }

    fn judged(judge: Judge, record: &(Vec<f64>, Vec<f64>, Vec<f64>)) -> (Vec<Judgement>, usize) {
        let (mut judge, mut found, mut most) = (judge, Vec::new(), 0);
        for ((t, y), w) in record.0.iter().zip(&record.1).zip(&record.2) {
            judge.take(*t, *y, *w, &mut |judgement| found.push(judgement));
            most = most.max(judge.t.len());
        }
        judge.finish(&mut |judgement| found.push(judgement));
        (found, most)
    }

    #[test]
    fn the_judgement_is_that_of_the_whole_record() {
        let record = record(100);
        let (t, y, wanted) = &record;
        let parts = [
            Part::Step { at: 20.0, until: 33.0, to: 1.0 },
            Part::Disturbance { at: 33.0, until: 40.0 },
            Part::Step { at: 40.0, until: 60.0, to: 0.0 },
            Part::Disturbance { at: 60.0, until: 100.0 },
        ];
        let whole = parts.map(|part| match part {
            Part::Step { at, until, to } => Judgement::Step(step_response(t, y, at, until, to).unwrap()),
            Part::Disturbance { at, until } => {
                Judgement::Disturbance(recovery(t, y, Some(wanted), at, until).unwrap())
            }
        });
        let (found, _) = judged(Judge::new(parts), &record);
        assert_eq!(found.len(), whole.len());
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9 * (1.0 + b.abs());
        for (found, whole) in found.iter().zip(&whole) {
            let same = match (found, whole) {
                (Judgement::Step(a), Judgement::Step(b)) => {
                    near(a.settling_s.unwrap_or(-1.0), b.settling_s.unwrap_or(-1.0))
                        && near(a.rise_s.unwrap(), b.rise_s.unwrap())
                        && near(a.until_s, b.until_s)
                        && near(a.band, b.band)
                        && near(a.steady_state_error, b.steady_state_error)
                }
                (Judgement::Disturbance(a), Judgement::Disturbance(b)) => {
                    near(a.peak, b.peak) && near(a.iae, b.iae) && near(a.until_s, b.until_s)
                }
                _ => false,
            };
            assert!(same, "{found:?} {whole:?}");
        }
    }

    #[test]
    fn a_long_record_is_forgotten_and_a_long_part_is_judged_in_its_beginning() {
        let record = record(1_000);
        let step = |i: usize| Part::Step {
            at: 20.0 * i as f64,
            until: 20.0 * (i + 1) as f64,
            to: f64::from(i as u32 % 2),
        };
        let (found, most) = judged(Judge::new((1..50).map(step).collect::<Vec<_>>()), &record);
        assert_eq!(found.len(), 49);
        assert!(most < 4 * FORGET_EVERY, "{most}");

        let parts = vec![Part::Disturbance { at: 20.0, until: 1_000.0 }];
        let (found, most) = judged(Judge { most_samples: 1_000, ..Judge::new(parts) }, &record);
        let Judgement::Disturbance(recovery) = &found[0] else { panic!("{found:?}") };
        assert!((recovery.until_s - 29.99).abs() < 0.3 && most < 2 * FORGET_EVERY, "{recovery:?} {most}");
    }
}
