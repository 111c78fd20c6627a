//! The lines that the plots of a run show, thinned while the run is read.

use std::collections::VecDeque;

use whirlstand_logs::Line;

use crate::spectra::Spectrum;

/// Most spans that are stored; beyond that, neighbours are joined.
const MOST_SPANS: usize = 4_096;

/// Lines for the plots of a run, SI.
#[derive(Debug, Clone, Default)]
pub struct Lines {
    /// Lines of each output.
    pub outputs: Vec<OutputLines>,
    /// Applied value of each input; without truth, the command.
    pub inputs: Vec<Line>,
    /// Consistency of the estimator; empty without one.
    pub nis: NisLine,
    /// Errors of the estimated states; empty without truth or estimate.
    pub errors: Vec<ErrorLines>,
    /// Spectra of the measurements of each output.
    pub output_spectra: Vec<Spectrum>,
    /// Spectra of each applied input.
    pub input_spectra: Vec<Spectrum>,
    /// Parts over which the last command was held.
    pub held: Spans,
    /// Parts in failsafe.
    pub failsafe: Spans,
}

/// Lines of one output.
#[derive(Debug, Clone, Default)]
pub struct OutputLines {
    /// Measurements of the output's sensor.
    pub measured: Line,
    /// Output computed from the true states and applied inputs.
    pub truth: Line,
    /// Output computed from the estimated states.
    pub estimate: Line,
    /// The setpoint; NaN where nothing is tracked.
    pub wanted: Line,
}

/// Lines of the estimate of one state.
#[derive(Debug, Clone, Default)]
pub struct ErrorLines {
    /// Estimate minus truth.
    pub error: Line,
    /// The standard deviation that the filter claims.
    pub claimed: Line,
}

/// Sums of a normalised innovation squared and of its degrees of freedom, up to a time.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    t: f64,
    nis: f64,
    degrees: f64,
}

/// The normalised innovation squared over its degrees of freedom, as a mean over about one second.
#[derive(Debug, Clone, Default)]
pub struct NisLine {
    /// The mean.
    pub ratio: Line,
    /// First and last time, s.
    pub ends_s: (f64, f64),
    /// Number of steps with an innovation.
    pub steps: u64,
    /// Number of steps that are averaged to either side.
    half: usize,
    total: Sums,
    /// Cumulative sums at each of the last steps: twice `half` steps and two more at most.
    recent: VecDeque<Sums>,
    /// Number of steps whose mean has been written.
    written: u64,
}

impl NisLine {
    pub(crate) fn new(period_s: f64) -> Self {
        Self { half: ((0.5 / period_s).round() as usize).max(1), ..Self::default() }
    }

    /// Takes in the estimate at time `t`, s. A step without a fresh measurement is ignored.
    pub(crate) fn take(&mut self, t: f64, nis: f64, degrees: f64) {
        if degrees <= 0.0 || !nis.is_finite() {
            return;
        }
        if self.steps == 0 {
            self.ends_s.0 = t;
            // The sums before the first step.
            self.recent.push_back(Sums::default());
        }
        self.ends_s.1 = t;
        self.steps += 1;
        self.total = Sums { t, nis: self.total.nis + nis, degrees: self.total.degrees + degrees };
        self.recent.push_back(self.total);
        // The step in the middle has as many steps on its right as on its left; at the start there are fewer.
        if self.steps > self.half as u64 {
            self.write(self.half);
        }
    }

    /// Writes the mean for the next step, over up to `right` steps to either side.
    fn write(&mut self, right: usize) {
        let h = right.min(usize::try_from(self.written).unwrap_or(usize::MAX));
        // The sums with the step itself stand `right` before the last ones.
        let at = self.recent.len() - 1 - right;
        let (from, middle, until) = (self.recent[at - h - 1], self.recent[at], self.recent[at + h]);
        self.ratio.push(middle.t, (until.nis - from.nis) / (until.degrees - from.degrees));
        self.written += 1;
        while self.recent.len() > 2 * self.half + 1 {
            self.recent.pop_front();
        }
    }

    /// Writes the remaining means at the end of the run.
    pub(crate) fn finish(&mut self) {
        while self.written < self.steps {
            let right = self.steps - 1 - self.written;
            self.write(usize::try_from(right).unwrap_or(0));
        }
    }

    /// Degrees of freedom of one mean.
    pub fn degrees(&self) -> f64 {
        self.total.degrees / self.steps.max(1) as f64 * (2 * self.half + 1) as f64
    }
}

/// Parts of a run in which a condition held.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Spans {
    /// Start and end of each, s.
    pub parts: Vec<(f64, f64)>,
    /// Number of steps.
    pub steps: u64,
    gap: f64,
}

impl Spans {
    /// Takes a step of `period_s` seconds at `t`, s.
    pub(crate) fn take(&mut self, t: f64, period_s: f64) {
        self.steps += 1;
        let near = (0.5 * period_s).max(self.gap);
        match self.parts.last_mut() {
            Some((_, until)) if t - *until < near => *until = t + period_s,
            _ => self.parts.push((t, t + period_s)),
        }
        while self.parts.len() > MOST_SPANS {
            self.gap = 2.0 * self.gap.max(period_s);
            self.parts = joined(&self.parts, self.gap);
        }
    }

    /// The parts, of which neighbouring ones are joined until there are at most `most`. Parts separated by gaps up
    /// to `gap_s` seconds are joined first.
    pub fn at_most(&self, most: usize, gap_s: f64) -> Vec<(f64, f64)> {
        let (mut parts, mut gap) = (self.parts.clone(), gap_s.max(f64::MIN_POSITIVE));
        while parts.len() > most {
            parts = joined(&parts, gap);
            gap *= 2.0;
        }
        parts
    }
}

/// The parts, of which those at most `gap` apart are joined.
fn joined(parts: &[(f64, f64)], gap: f64) -> Vec<(f64, f64)> {
    let mut joined: Vec<(f64, f64)> = Vec::new();
    for part in parts {
        match joined.last_mut() {
            Some(last) if part.0 - last.1 <= gap => last.1 = part.1,
            _ => joined.push(*part),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_logs::stats::moving_average;
    use whirlstand_test_harness::noise;

    #[test]
    fn the_nis_is_averaged_as_a_whole_record_is() {
        for n in [3, 12, 300] {
            let mut line = NisLine::new(0.1);
            let nis: Vec<f64> = noise(n, 3).iter().map(|e| e * e).collect();
            let degrees: Vec<f64> = (0..n).map(|i| 1.0 + (i % 3) as f64).collect();
            (0..n).for_each(|i| line.take(i as f64, nis[i], degrees[i]));
            line.finish();
            let expected: Vec<f64> =
                moving_average(&nis, 5).iter().zip(moving_average(&degrees, 5)).map(|(a, b)| a / b).collect();
            let (t, ratio) = line.ratio.points();
            assert_eq!(t, (0..n).map(|i| i as f64).collect::<Vec<_>>());
            assert!(ratio.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9), "{ratio:?} {expected:?}");
            assert!(line.recent.len() <= 13, "{}", line.recent.len());
        }
    }

    #[test]
    fn many_spans_are_joined_and_their_steps_counted() {
        let mut spans = Spans::default();
        (0..100_000).for_each(|i| spans.take(3.0 * i as f64 * 0.001, 0.001));
        assert!(spans.parts.len() <= MOST_SPANS && spans.steps == 100_000);
        assert!(spans.at_most(60, 0.6).len() <= 60);
        let mut few = Spans::default();
        [1.0, 1.001, 2.0].iter().for_each(|t| few.take(*t, 0.001));
        assert_eq!(few.parts.len(), 2);
    }
}
