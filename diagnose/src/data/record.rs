//! A record as a diagnosis uses it: inputs on an even grid, and every measured output as its own sequence.

use std::borrow::Cow;
use std::sync::Arc;

use crate::thresholds::{FIRST_COMMAND_SHARE, HELD_OUT_SHARE, MAX_SEARCHED_STEPS};
use whirlstand_logs::{Record, repeated_every};
use whirlstand_vehicle::{Simulator, Vehicle};

use crate::DiagnoseError;
use whirlstand_ident::identify::data::Segment;

/// Number of samples from which on a record is long; a vector of so many takes 1.6 MB, and a fit needs dozens.
const LONG_SAMPLES: usize = 200_000;

/// One measured output, sampled every `stride` steps from step `first` on.
#[derive(Debug, Clone, PartialEq)]
pub struct Channel {
    /// Index of the vehicle's output.
    pub output: usize,
    /// Steps between two samples.
    pub stride: usize,
    /// Step of the first sample, less than `stride`; a sample that was not measured is missing.
    pub first: usize,
    /// Measured values, SI; NaN where there is none.
    pub values: Vec<f64>,
    /// True for samples that count: measured, and not excluded as held, clipped or an outlier.
    pub good: Vec<bool>,
    /// Measured samples at the beginnings of records after the first, in their order. They have no past from which noise
    /// could be predicted: likelihoods leave them out, as they leave out the first samples of all, but initial states are
    /// fitted to them, and filters corrected by them.
    pub early: Vec<usize>,
    /// Standard deviation of the noise that the vehicle file declares, SI; 0 where it declares none.
    pub declared: f64,
}

impl Channel {
    /// The sample that lies at a step, measured or not; it may lie beyond the last one.
    pub fn sample_at(&self, step: usize) -> Option<usize> {
        let since = step.checked_sub(self.first)?;
        // Divided only where there is something to divide: this is asked at every step of every run that follows a record.
        match self.stride {
            1 => Some(since),
            stride => since.is_multiple_of(stride).then(|| since / stride),
        }
    }

    /// The measured value at a step, if a valid sample lies there.
    pub fn measured_at(&self, step: usize) -> Option<f64> {
        let sample = self.sample_at(step)?;
        (*self.good.get(sample)? || self.early.binary_search(&sample).is_ok()).then(|| self.values[sample])
    }

    /// True for samples that count, and for early ones.
    pub fn known(&self) -> Cow<'_, [bool]> {
        let mut known = Cow::Borrowed(&self.good[..]);
        if !self.early.is_empty() {
            let known = known.to_mut();
            self.early.iter().for_each(|k| known[*k] = true);
        }
        known
    }

    /// First samples of the records that begin at the given steps.
    pub fn begins<'s>(&'s self, starts: &'s [usize]) -> impl Iterator<Item = usize> + 's {
        starts
            .iter()
            .map(|start| start.saturating_sub(self.first).div_ceil(self.stride).min(self.values.len()))
    }

    /// The step of a sample.
    pub fn step(&self, sample: usize) -> usize {
        self.first + sample * self.stride
    }
}

/// A record on an even grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Data {
    /// Path of the file from which the record was read.
    pub origin: String,
    /// Time of step 0 on the record's clock, s.
    pub start_s: f64,
    /// Sampling period, s.
    pub period_s: f64,
    /// Number of steps.
    pub steps: usize,
    /// Steps x inputs, row after row, within the vehicle's limits.
    pub inputs: Vec<f64>,
    /// Number of inputs.
    pub m: usize,
    /// First steps of the records, when there are several: each record has its own initial state.
    pub starts: Vec<usize>,
    /// The same first steps on the clock of each original record, on which effects count time.
    pub clocks: Vec<u64>,
    /// True when the first commands were already applied before the records began; else the inputs were at
    /// rest.
    pub held: bool,
    /// Memory of the predictor, s: the time for which a filter with process noise remembers prediction
    /// errors. `None` for a free run, which is never corrected.
    pub memory_s: Option<f64>,
    /// Memory of the most likely predictor that follows the records, s, where it was determined.
    pub likeliest_s: Option<f64>,
    /// The most likely filter of all that have a memory for each state, where it was determined.
    pub likeliest_filter: Option<Arc<StateFilter>>,
    /// The outputs that were measured.
    pub channels: Vec<Channel>,
}

/// A filter that follows a record with a memory of its own for each state.
#[derive(Debug, Clone, PartialEq)]
pub struct StateFilter {
    /// Whether a force that wanders is estimated on every state with dynamics, as further states after the vehicle's.
    pub forced: bool,
    /// Memories by state, s, those of forces included.
    pub memories_s: Vec<f64>,
}

/// A multiple of the records' period at which all of them together are short enough to be searched in
/// minutes; `None` when they already are.
pub fn coarser_period(records: &[Record]) -> Option<f64> {
    coarser_period_for(records, None, MAX_SEARCHED_STEPS)
}

/// A multiple of the records' period, or of the given one, at which all of them together have at most `most`
/// steps; `None` when they already have no more.
pub fn coarser_period_for(records: &[Record], period_s: Option<f64>, most: f64) -> Option<f64> {
    let first = records.first().filter(|r| r.time_unit == "s")?;
    let steps = first.time.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>();
    let own = period_s.unwrap_or_else(|| whirlstand_logs::stats::median(&steps));
    let steps = records.iter().map(Record::duration).sum::<f64>() / own;
    (own > 0.0 && steps > most + 1.0).then(|| own * (steps / most - 1e-6).ceil())
}

impl Data {
    /// Takes the vehicle's inputs and outputs out of a record.
    ///
    /// # Errors
    /// When an input or every output is missing, or the record has no clock.
    pub fn new(record: &Record, vehicle: &Vehicle, period_s: Option<f64>) -> Result<Self, DiagnoseError> {
        let segment = Segment::new(record, vehicle, period_s, (None, None))?;
        let p = vehicle.outputs.len();
        let channels = (0..p).filter_map(|i| channel(&segment, i, p, vehicle.outputs[i].noise)).collect();
        Ok(Self {
            origin: record.origin.clone(),
            start_s: segment.start_s,
            period_s: segment.period_s,
            steps: segment.steps,
            inputs: segment.inputs,
            m: vehicle.inputs.len(),
            starts: vec![0],
            clocks: vec![segment.first_step],
            held: false,
            memory_s: None,
            likeliest_s: None,
            likeliest_filter: None,
            channels,
        })
    }

    /// A simulator from which those of all records begin. `None` when the vehicle has no finite discretisation.
    pub fn simulator(&self, vehicle: &Vehicle) -> Option<Simulator> {
        Simulator::expected(vehicle, self.period_s).ok()
    }

    /// The simulator for the record that begins at a step. Most of the work is in that of all records: a log with gaps has
    /// many short ones.
    pub fn begin(&self, simulator: &Simulator, step: usize) -> Simulator {
        let mut simulator = simulator.clone();
        if self.held {
            simulator.rest_at(self.commands(step));
        }
        simulator.begin_at(self.clock(step));
        simulator
    }

    /// A step on the clock of the original record to which it belongs.
    pub fn clock(&self, step: usize) -> u64 {
        let record = self.starts.partition_point(|start| *start <= step).saturating_sub(1);
        let own = |(start, clock): (&usize, &u64)| clock + (step - start) as u64;
        self.starts.get(record).zip(self.clocks.get(record)).map_or(step as u64, own)
    }

    /// Time of a step, s, on the clock of the effects: since the beginning of the original record.
    pub fn time_s(&self, step: usize) -> f64 {
        self.clock(step) as f64 * self.period_s
    }

    /// First and last time of all records, s, on the clock of the effects.
    pub fn times_s(&self) -> (f64, f64) {
        let lengths =
            self.starts.iter().skip(1).chain([&self.steps]).zip(&self.starts).map(|(end, start)| end - start);
        let ends = self.clocks.iter().zip(lengths).map(|(clock, steps)| clock + steps as u64);
        let first = self.clocks.iter().min().map_or(0.0, |first| *first as f64 * self.period_s);
        (first, ends.max().map_or(0.0, |last| last as f64 * self.period_s))
    }

    /// The inputs at a step.
    pub fn commands(&self, step: usize) -> &[f64] {
        self.inputs.get(step * self.m..(step + 1) * self.m).unwrap_or_default()
    }

    /// True when a record's first commands are far from rest: delays and lags then depend on commands before
    /// the record.
    pub fn begins_moving(&self, vehicle: &Vehicle) -> bool {
        let reach: Vec<f64> =
            (0..self.m).map(|j| self.input(j).fold(0.0f64, |m, u| m.max(u.abs()))).collect();
        self.starts.iter().any(|start| {
            let inputs = self.commands(*start).iter().zip(&vehicle.inputs).zip(&reach);
            inputs
                .into_iter()
                .any(|((u, input), reach)| (u - input.neutral()).abs() > FIRST_COMMAND_SHARE * reach)
        })
    }

    /// Number of samples of all channels.
    pub fn samples(&self) -> usize {
        self.channels.iter().map(|c| c.values.len()).sum()
    }

    /// True for so many samples that vectors of all of them fill the memory: their fits are made one after
    /// another, each on all processors, so that the memory does not grow with the number of processors.
    pub fn is_long(&self) -> bool {
        self.samples() > LONG_SAMPLES
    }

    /// Number of samples that count.
    pub fn good(&self) -> usize {
        self.channels.iter().map(|c| c.good.iter().filter(|g| **g).count()).sum()
    }

    /// Length of all records, s.
    pub fn duration_s(&self) -> f64 {
        self.steps as f64 * self.period_s
    }

    /// First step of the last part, on which predictions are scored.
    pub fn held_out_from(&self) -> usize {
        ((1.0 - HELD_OUT_SHARE) * self.steps as f64) as usize
    }

    /// All values of one input.
    pub fn input(&self, j: usize) -> impl Iterator<Item = f64> + '_ {
        self.inputs.iter().skip(j).step_by(self.m).copied()
    }

    /// Fastest mean rate of an input over `time_s`, at least one step, within one record.
    pub fn fastest(&self, j: usize, time_s: f64) -> f64 {
        let values: Vec<f64> = self.input(j).collect();
        let span = ((time_s / self.period_s).round() as usize).max(1);
        let apart = |k: usize| self.starts.iter().any(|start| (k + 1..=k + span).contains(start));
        let within = (0..values.len().saturating_sub(span)).filter(|k| !apart(*k));
        let moved = within.map(|k| (values[k + span] - values[k]).abs()).fold(0.0, f64::max);
        moved / (span as f64 * self.period_s)
    }

    /// Index ranges of the channels in a vector of all samples, channel after channel.
    pub fn ranges(&self) -> Vec<std::ops::Range<usize>> {
        let mut at = 0;
        self.channels
            .iter()
            .map(|c| {
                let range = at..at + c.values.len();
                at = range.end;
                range
            })
            .collect()
    }

    /// Ranges of a channel's samples, one for each record.
    pub fn parts(&self, channel: &Channel) -> impl Iterator<Item = std::ops::Range<usize>> {
        let mut begins: Vec<usize> = channel.begins(&self.starts).collect();
        begins[0] = 0;
        begins.push(channel.values.len());
        (1..begins.len()).map(move |i| begins[i - 1]..begins[i])
    }

    /// Measured values of all channels, channel after channel.
    pub fn measured(&self) -> Vec<f64> {
        self.channels.iter().flat_map(|c| c.values.iter().copied()).collect()
    }

    /// Residual, measured minus predicted, with gaps filled.
    pub fn residual(&self, predicted: &[f64]) -> Vec<f64> {
        let measured = self.channels.iter().flat_map(|c| &c.values);
        let mut residual: Vec<f64> = measured.zip(predicted).map(|(y, p)| y - p).collect();
        self.fill(&mut residual);
        residual
    }

    /// Replaces samples that do not count by linear interpolation between their neighbours. As the operation
    /// is linear, it may be applied to a residual and to a signature alike, and both stay comparable.
    pub fn fill(&self, samples: &mut [f64]) {
        for (channel, range) in self.channels.iter().zip(self.ranges()) {
            if channel.good.contains(&false) {
                fill(&mut samples[range], &channel.known());
            }
        }
    }

    /// As [`Data::fill`], but copies only where there is something to fill.
    pub fn filled<'s>(&self, samples: &'s [f64]) -> Cow<'s, [f64]> {
        let mut samples = Cow::Borrowed(samples);
        if self.channels.iter().any(|c| c.good.contains(&false)) {
            self.fill(samples.to_mut());
        }
        samples
    }
}

fn channel(segment: &Segment, i: usize, p: usize, declared: f64) -> Option<Channel> {
    let all = segment.output(i, p);
    let present: Vec<usize> = (0..all.len()).filter(|k| all[*k].is_finite()).collect();
    let first = *present.first()?;
    // A sensor slower than the record delivers a sample every `stride` steps.
    let mut gaps: Vec<usize> = present.windows(2).map(|w| w[1] - w[0]).collect();
    gaps.sort_unstable();
    let mut stride = gaps.get(gaps.len() / 2).copied().unwrap_or(1);
    let mut first = first;
    let steps: Vec<usize> = (0..all.len()).collect();
    if let Some((start, every)) = repeated_every(&steps, &all) {
        (first, stride) = (start % every, every);
    }
    // A sensor that starts late has missing samples before.
    first %= stride;
    let values: Vec<f64> = all.iter().skip(first).step_by(stride).copied().collect();
    let good = values.iter().map(|v| v.is_finite()).collect();
    Some(Channel { output: i, stride, first, values, good, early: Vec::new(), declared })
}

fn fill(values: &mut [f64], good: &[bool]) {
    let mut last: Option<usize> = None;
    let mut k = 0;
    while k < values.len() {
        // Most of a record counts, and every sensitivity of every fit is filled.
        if good[k..].first_chunk::<64>().is_some_and(|chunk| chunk.iter().fold(true, |all, good| all & good))
        {
            last = Some(k + 63);
            k += 64;
            continue;
        }
        if good[k] {
            last = Some(k);
            k += 1;
            continue;
        }
        let next = (k..values.len()).find(|j| good[*j]);
        let end = next.unwrap_or(values.len());
        for j in k..end {
            values[j] = match (last, next) {
                (Some(a), Some(b)) => values[a] + (values[b] - values[a]) * (j - a) as f64 / (b - a) as f64,
                (Some(a), None) => values[a],
                (None, Some(b)) => values[b],
                (None, None) => 0.0,
            };
        }
        k = end;
    }
}

#[cfg(test)]
mod tests {
    use super::fill;

    #[test]
    fn gaps_are_bridged_by_straight_lines() {
        let mut v = [9.0, 1.0, f64::NAN, f64::NAN, 4.0, f64::NAN];
        fill(&mut v, &[false, true, false, false, true, false]);
        assert_eq!(v, [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]);
        let line: Vec<f64> = (0..300).map(f64::from).collect();
        for lost in [70..75, 63..64, 128..290, 64..192] {
            let good: Vec<bool> = (0..300).map(|k| !lost.contains(&k)).collect();
            let mut v: Vec<f64> =
                line.iter().zip(&good).map(|(v, g)| if *g { *v } else { f64::NAN }).collect();
            fill(&mut v, &good);
            assert!(v.iter().zip(&line).all(|(v, line)| (v - line).abs() < 1e-9), "{lost:?}");
        }
    }
}
