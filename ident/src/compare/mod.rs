//! Measured data against the simulation: what the simulation gets wrong, not why.

mod figures;
pub(crate) mod grid;
mod simulate;
mod words;

pub(crate) use figures::spectrum;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use whirlstand_logs::{MissingSignal, Record};
use whirlstand_vehicle::{SimulatorError, Vehicle};

use crate::spectrum::Peak;

/// Schema of [`Comparison`].
pub const COMPARISON_SCHEMA: &str = "whirlstand.comparison.v1";

/// Why a record cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// An input of the vehicle is not in the record.
    #[error(transparent)]
    Input(#[from] MissingSignal),
    /// No output of the vehicle is in the record.
    #[error(
        "{origin} has no output of '{vehicle}': wanted is at least one of {}. It has: {}. Use --map {}=NAME[unit] to say which signal it is.",
        outputs.join(", "),
        available.join(", "),
        outputs.first().map_or("roll", |o| o.as_str())
    )]
    NoOutput {
        /// Where the record was read from.
        origin: String,
        /// Name of the vehicle.
        vehicle: String,
        /// Its outputs.
        outputs: Vec<String>,
        /// What the record has.
        available: Vec<String>,
    },
    /// The record counts samples and no period was given.
    #[error("{origin} has no time column: give the sample period (--period SECONDS)")]
    NoClock {
        /// Where the record was read from.
        origin: String,
    },
    /// Too few points.
    #[error(
        "{origin} has {points} points at a period of {period_s} s; at least 16 are needed to compare anything"
    )]
    TooShort {
        /// Where the record was read from.
        origin: String,
        /// Points on the grid.
        points: usize,
        /// Period of the grid, s.
        period_s: f64,
    },
    /// Too many points for the memory of a usual machine.
    #[error(
        "{duration_s} s at a period of {period_s} s are more than 50 million points: give a longer period"
    )]
    TooFine {
        /// Length of the record, s.
        duration_s: f64,
        /// Period of the grid, s.
        period_s: f64,
    },
    /// An output of the vehicle is in the record, but without a value.
    #[error("{origin}: {name} holds no number in the compared part")]
    NoValue {
        /// Where the record was read from.
        origin: String,
        /// Name of the signal.
        name: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}

/// What to compare.
#[derive(Debug, Clone, PartialEq)]
pub struct CompareOptions {
    /// Period of the simulation, s; the record's own (median) when `None`.
    pub period_s: Option<f64>,
    /// Start of the compared part, s of the record's clock.
    pub from_s: Option<f64>,
    /// End of the compared part, s of the record's clock.
    pub until_s: Option<f64>,
    /// How far the short predictions look ahead, s.
    pub horizon_s: f64,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { period_s: None, from_s: None, until_s: None, horizon_s: 2.0 }
    }
}

/// A vehicle's simulation held against a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// [`COMPARISON_SCHEMA`].
    pub schema: String,
    /// The verdict in a sentence.
    pub verdict: String,
    /// Where the record was read from.
    pub record: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Start of the compared part, s of the record's clock.
    pub from_s: f64,
    /// End of the compared part, s of the record's clock.
    pub until_s: f64,
    /// Period of the simulation, s.
    pub period_s: f64,
    /// Points compared.
    pub samples: usize,
    /// How far the short predictions look ahead, s.
    pub horizon_s: f64,
    /// True when the free run left all bounds, so that only short predictions could be judged.
    pub diverged: bool,
    /// How the initial state was found.
    pub initial_state_method: String,
    /// Initial state of the free run, by name, SI.
    pub initial_state: BTreeMap<String, f64>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputComparison>,
    /// Outputs of the vehicle that the record does not have.
    pub not_compared: Vec<String>,
    /// What else should be known about the record: gaps, uneven sampling.
    pub remarks: Vec<String>,
    /// The signals themselves, for the report.
    #[serde(skip)]
    pub series: Series,
}

/// Figures of one output, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputComparison {
    /// SI unit.
    pub unit: String,
    /// 100 (1 - norm(y - y_sim) / norm(y - mean y)) of the free run, %; `None` when it diverged or the measured
    /// output never changes.
    pub fit: Option<f64>,
    /// The same after the mean of the residual is taken off.
    pub fit_bias_removed: Option<f64>,
    /// Root of the mean square residual.
    pub rmse: Option<f64>,
    /// Mean of the residual (measured minus simulated).
    pub bias: Option<f64>,
    /// Pearson's correlation of measured and simulated; blind to gain and offset.
    pub correlation: Option<f64>,
    /// Standard deviation of the noise that the vehicle file declares for the sensor.
    pub declared_noise: f64,
    /// Fit of the predictions over the horizon, %.
    pub horizon_fit: Option<f64>,
    /// Root of the mean square error of the predictions over the horizon.
    pub horizon_rmse: Option<f64>,
    /// Where the residual is greatest.
    pub worst: Option<Interval>,
    /// Rms residual in the last tenth of the record over that of the rest.
    pub growth: Option<f64>,
    /// Lines in the spectrum of the residual, strongest first.
    pub lines: Vec<Peak>,
    /// Mean square residual in twenty equal parts of the record: the quadratic error over time.
    pub quadratic_error: Vec<Interval>,
}

/// A part of the record and the residual in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Start, s of the record's clock.
    pub from_s: f64,
    /// End, s of the record's clock.
    pub until_s: f64,
    /// Mean square residual.
    pub mean_square: f64,
}

/// The signals of a comparison.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Time, s of the record's clock.
    pub t: Vec<f64>,
    /// Inputs: name, unit and values as applied.
    pub inputs: Vec<(String, String, Vec<f64>)>,
    /// Outputs in the vehicle's order.
    pub outputs: Vec<OutputSeries>,
}

/// The signals of one output, NaN where there is none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OutputSeries {
    /// Name.
    pub name: String,
    /// Measured.
    pub measured: Vec<f64>,
    /// Free run.
    pub simulated: Vec<f64>,
    /// Measured minus predicted over the horizon.
    pub prediction_error: Vec<f64>,
}

/// Holds the simulation of `vehicle`, driven by the inputs in `record`, against the outputs in `record`.
///
/// # Errors
/// [`CompareError`]; what the record lacks is named, beside what it has.
pub fn compare(
    record: &Record,
    vehicle: &Vehicle,
    options: &CompareOptions,
) -> Result<Comparison, CompareError> {
    let grid = grid::grid(record, vehicle, options)?;
    for (values, &i) in grid.measured.iter().zip(&grid.outputs) {
        if !values.iter().any(|v| v.is_finite()) {
            return Err(CompareError::NoValue {
                origin: record.origin.clone(),
                name: vehicle.outputs[i].name.clone(),
            });
        }
    }
    let run = simulate::free_run(&grid, vehicle)?;
    let errors = simulate::predictions(&grid, vehicle, &run, options.horizon_s)?;
    let m = vehicle.inputs.len();
    let inputs = vehicle.inputs.iter().enumerate().map(|(j, input)| {
        let values = grid.inputs.iter().skip(j).step_by(m).copied().collect();
        (input.name.clone(), input.unit.si_symbol(), values)
    });
    let series = Series {
        t: grid.t.clone(),
        inputs: inputs.collect(),
        outputs: (0..grid.outputs.len())
            .map(|j| OutputSeries {
                name: vehicle.outputs[grid.outputs[j]].name.clone(),
                measured: grid.measured[j].clone(),
                simulated: run.outputs[j].clone(),
                prediction_error: errors[j].clone(),
            })
            .collect(),
    };
    let outputs = series.outputs.iter().zip(&grid.outputs).map(|(signals, &i)| {
        let output = &vehicle.outputs[i];
        let figures = figures::figures(&grid, signals, run.diverged, output.noise, output.unit.si_symbol());
        (output.name.clone(), figures)
    });
    let mut comparison = Comparison {
        schema: COMPARISON_SCHEMA.into(),
        verdict: String::new(),
        record: record.origin.clone(),
        vehicle: vehicle.name.clone(),
        from_s: grid.start_s,
        until_s: grid.t[grid.t.len() - 1],
        period_s: grid.period_s,
        samples: grid.t.len(),
        horizon_s: options.horizon_s,
        diverged: run.diverged,
        initial_state_method: "least squares over the compared part".into(),
        initial_state: vehicle
            .states
            .iter()
            .map(|s| s.name.clone())
            .zip(run.initial.iter().copied())
            .collect(),
        outputs: outputs.collect(),
        not_compared: (0..vehicle.outputs.len())
            .filter(|i| !grid.outputs.contains(i))
            .map(|i| vehicle.outputs[i].name.clone())
            .collect(),
        remarks: words::remarks(&grid, vehicle),
        series,
    };
    comparison.remarks.extend(words::size(&comparison));
    comparison.verdict = words::verdict(&comparison);
    Ok(comparison)
}

impl Comparison {
    /// The comparison as at most 15 lines of text, without colour.
    pub fn text(&self) -> String {
        words::text(self)
    }

    /// True when the simulation explains every output: down to the declared noise, or with a fit of 90 % or more.
    pub fn agrees(&self) -> bool {
        words::all_agree(self)
    }

    /// The outputs in the vehicle's order: name and figures.
    pub fn ordered(&self) -> impl Iterator<Item = (&str, &OutputComparison)> {
        self.series.outputs.iter().filter_map(|s| Some((s.name.as_str(), self.outputs.get(&s.name)?)))
    }
}
