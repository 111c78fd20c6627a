//! Predictions of a record over a horizon, and the part of them that is due to the commands.

use statrs::distribution::{ContinuousCDF, StudentsT};
use whirlstand_logs::stats::mean;
use whirlstand_vehicle::Vehicle;

use crate::data::record::{Channel, Data};
use crate::model::columns::dot;
use crate::model::commands::Commands;
use crate::model::free_run::FreeRun;
use crate::thresholds::{LEAST_COMPARED_BLOCKS, MAX_P_VALUE};

/// Settings of predictions: their horizon, the filter's memory, the known commands, and the block length for
/// errors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    /// Horizon in steps; `None` for a free run.
    pub horizon: Option<usize>,
    /// Memory of the filter that follows the record up to the start of a prediction, s.
    memory_s: Option<f64>,
    /// Commands that a prediction knows.
    commands: Commands,
    /// Block length in steps: twice the correlation length of the errors.
    block: usize,
}

/// A predicted sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub step: usize,
    pub measured: f64,
    pub predicted: f64,
    /// Last measurement before the prediction began; NaN for a free run.
    pub last: f64,
}

impl Span {
    /// A free run, and predictions over these horizons, steps, the longest last. In a closed loop the future
    /// commands respond to the predicted motion: where they cancel a disturbance, a model that knows the
    /// commands but not the disturbance predicts worse than none. So predictions without future commands are
    /// made too (Dufour and Renault, Econometrica 66, 1998). The filter that follows the record has a memory
    /// of `memory_s`, or of the horizon.
    pub fn all(horizons: &[usize], period_s: f64, memory_s: Option<f64>) -> Vec<Self> {
        let longest = horizons.last().copied().unwrap_or(1);
        let free = Self { horizon: None, memory_s: None, commands: Commands::Recorded, block: 2 * longest };
        let ahead = |horizon: &usize| {
            let memory_s = Some(memory_s.unwrap_or(*horizon as f64 * period_s));
            let of = |commands| Self { horizon: Some(*horizon), memory_s, commands, block: 2 * horizon };
            [Commands::Recorded, Commands::Held].map(of)
        };
        horizons.iter().flat_map(ahead).chain([free]).collect()
    }

    /// True for predictions that know neither the future commands, which cancel disturbances in a closed loop, nor
    /// rest on a free run, which an unstable vehicle leaves.
    pub fn is_foresight(self) -> bool {
        self.horizon.is_some() && self.commands == Commands::Held
    }

    /// Predictions of all samples, from states at rest; `None` where the vehicle has no valid prediction.
    pub fn predicted(self, vehicle: &Vehicle, data: &Data) -> Option<Vec<f64>> {
        let data = Data { memory_s: self.memory_s, ..data.clone() };
        let run = FreeRun::new(vehicle, &data);
        let rest = vec![0.0; run.initials()];
        match self.horizon {
            Some(horizon) => run.ahead(vehicle, &run.begun(vehicle, &rest, 0), horizon, self.commands).ok(),
            None => run.run_vehicle(vehicle, &rest).ok(),
        }
    }
}

/// Predicted samples of a channel that count. The first predictions of a record start from an unknown initial
/// state and are left out.
pub(super) fn samples(channel: &Channel, data: &Data, predicted: &[f64], span: Span) -> Vec<Sample> {
    let good = (0..channel.values.len()).filter(|s| channel.good[*s] && predicted[*s].is_finite());
    let sample = |s: usize| {
        let step = channel.step(s);
        let since = data.starts.iter().copied().rfind(|start| *start <= step)?;
        let last = match span.horizon {
            Some(h) if step < since + h => return None,
            Some(h) => last_value(channel, step, since, h)?,
            None => f64::NAN,
        };
        Some(Sample { step, measured: channel.values[s], predicted: predicted[s], last })
    };
    good.filter_map(sample).collect()
}

/// Last measurement before the prediction of a step began, as [`FreeRun::ahead`] begins it.
fn last_value(channel: &Channel, step: usize, since: usize, horizon: usize) -> Option<f64> {
    let every = (horizon / 4).max(1);
    let begun = since + every * ((step - since + every - horizon) / every);
    (since..begun).rev().take(4 * channel.stride).find_map(|k| channel.measured_at(k))
}

/// Mean of a quantity over blocks divided by its standard error, and the number of blocks; `None` for too
/// few.
pub(super) fn blocks(
    samples: &[Sample],
    span: Span,
    figure: impl Fn(&Sample) -> f64,
) -> Option<(f64, usize)> {
    let mut sums = std::collections::BTreeMap::<usize, f64>::new();
    for sample in samples {
        *sums.entry(sample.step / span.block.max(1)).or_default() += figure(sample);
    }
    let sums: Vec<f64> = sums.into_values().collect();
    if sums.len() < LEAST_COMPARED_BLOCKS {
        return None;
    }
    let middle = mean(&sums);
    let spread: f64 = sums.iter().map(|b| (b - middle).powi(2)).sum();
    let error = (spread / (sums.len() * (sums.len() - 1)) as f64).sqrt();
    (error > 0.0).then(|| (middle / error, sums.len()))
}

/// Hypothesis to test about the commands' part in the predictions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Asked {
    /// The commands' part correlates with the measurements, whatever its size.
    Tells,
    /// The commands' part in its own size reduces the error.
    Improves,
    /// The measurements contain less of the commands' part than its own size. That nothing of it was found
    /// does not say so: a record may be too short to show it.
    Lacks,
}

/// The judged channels in which, from a step on, the hypothesis about the commands' part of the vehicle's
/// predictions is significant in what neither the level, nor the last value, nor the predictions without
/// commands explain (Granger 1969), corrected for `looks` tests.
pub(super) fn told_by_commands(
    vehicle: &Vehicle,
    data: &Data,
    judged: &[usize],
    span: Span,
    (asked, from, looks): (Asked, usize, f64),
) -> Vec<usize> {
    let mut still = data.clone();
    for row in still.inputs.chunks_exact_mut(data.m.max(1)) {
        row.iter_mut().zip(&vehicle.inputs).for_each(|(u, input)| *u = input.neutral());
    }
    let Some((moved, rest)) = span.predicted(vehicle, data).zip(span.predicted(vehicle, &still)) else {
        return Vec::new();
    };
    let ranges = data.ranges();
    let is_told = |c: &usize| {
        let (channel, range) = (&data.channels[*c], ranges[*c].clone());
        let from_there = |predicted: &[f64]| -> Vec<Sample> {
            let all = samples(channel, data, predicted, span);
            all.into_iter().filter(|s| s.step >= from).collect()
        };
        let (moved, rest) = (from_there(&moved[range.clone()]), from_there(&rest[range]));
        if moved.len() != rest.len() {
            return false;
        }
        let column = |f: &dyn Fn(&Sample) -> f64| moved.iter().map(f).collect::<Vec<f64>>();
        let mut known = vec![vec![1.0; moved.len()], rest.iter().map(|s| s.predicted).collect()];
        if span.horizon.is_some() {
            known.push(column(&|s| s.last));
        }
        let known = orthogonal(known);
        let measured = beyond(column(&|s| s.measured), &known);
        let commanded = moved.iter().zip(&rest).map(|(a, b)| a.predicted - b.predicted).collect();
        let commanded = beyond(commanded, &known);
        let gained = |(s, (y, p)): (&Sample, (&f64, &f64))| {
            let gain = match asked {
                Asked::Tells => y * p,
                Asked::Improves => y * y - (y - p).powi(2),
                Asked::Lacks => (p - y) * p,
            };
            Sample { predicted: gain, ..*s }
        };
        let gains: Vec<Sample> = moved.iter().zip(measured.iter().zip(&commanded)).map(gained).collect();
        let Some((t, count)) = blocks(&gains, span, |s| s.predicted) else { return false };
        let tail = StudentsT::new(0.0, 1.0, (count - 1) as f64).map(|d| d.sf(t));
        tail.is_ok_and(|p| p * looks < MAX_P_VALUE)
    };
    judged.iter().copied().filter(is_told).collect()
}

/// Orthonormal columns (Gram-Schmidt); columns that are linearly dependent are left out.
fn orthogonal(columns: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for column in columns {
        let size = dot(&column, &column);
        let rest = beyond(column, &basis);
        let own = dot(&rest, &rest);
        if own > 1e-12 * size {
            basis.push(rest.iter().map(|v| v / own.sqrt()).collect());
        }
    }
    basis
}

/// Component of a column orthogonal to a basis.
fn beyond(mut column: Vec<f64>, basis: &[Vec<f64>]) -> Vec<f64> {
    for known in basis {
        let share = dot(&column, known);
        column.iter_mut().zip(known).for_each(|(v, k)| *v -= share * k);
    }
    column
}
