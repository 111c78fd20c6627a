//! Result of a comparison: options, figures of the outputs, signals, and errors.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_logs::SignalError;
use whirlstand_logs::shown::clean;
use whirlstand_logs::spectrum::Peak;
use whirlstand_vehicle::SimulatorError;

/// Schema identifier of [`Comparison`].
pub const COMPARISON_SCHEMA: &str = "whirlstand.comparison.v1";

/// Why a record cannot be compared.
#[derive(Debug, thiserror::Error)]
pub enum CompareError {
    /// An input of the vehicle is not in the record.
    #[error(transparent)]
    Input(#[from] SignalError),
    /// No output of the vehicle is in the record.
    #[error(
        "{origin} has no output of '{vehicle}': at least one of {} is required. It has: {}. Use --map {}=NAME[unit] to say which signal it is.",
        outputs.join(", "),
        available.join(", "),
        outputs.first().map_or("roll", |o| o.as_str())
    )]
    NoOutput {
        /// Path of the record.
        origin: String,
        /// Name of the vehicle.
        vehicle: String,
        /// Names of the vehicle's outputs.
        outputs: Vec<String>,
        /// Names of the signals in the record.
        available: Vec<String>,
    },
    /// The record is numbered by samples and no period was given.
    #[error("{origin} has no time column: give the sample period (--period SECONDS)")]
    NoClock {
        /// Path of the record.
        origin: String,
    },
    /// The record has too few points.
    #[error(
        "{origin} has {points} points at a period of {} s; at least 16 are needed for a comparison",
        clean(*period_s)
    )]
    TooShort {
        /// Path of the record.
        origin: String,
        /// Number of points on the grid.
        points: usize,
        /// Period of the grid, s.
        period_s: f64,
    },
    /// The record has too many points for the memory of a usual machine.
    #[error(
        "{} s at a period of {} s are more than 50 million points: give a longer period",
        clean(*duration_s), clean(*period_s)
    )]
    TooFine {
        /// Length of the record, s.
        duration_s: f64,
        /// Period of the grid, s.
        period_s: f64,
    },
    /// An output of the vehicle is in the record, but has no value.
    #[error("{origin}: {name} has no numeric value in the compared part")]
    NoValue {
        /// Path of the record.
        origin: String,
        /// Name of the signal.
        name: String,
    },
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Simulator(#[from] SimulatorError),
}

/// Options of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct CompareOptions {
    /// Period of the simulation, s; the record's own (median) when `None`.
    pub period_s: Option<f64>,
    /// Start of the compared part, s of the record's clock.
    pub from_s: Option<f64>,
    /// End of the compared part, s of the record's clock.
    pub until_s: Option<f64>,
    /// Horizon of the short predictions, s.
    pub horizon_s: f64,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { period_s: None, from_s: None, until_s: None, horizon_s: 2.0 }
    }
}

/// A vehicle's simulation compared with a record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Schema identifier, always [`COMPARISON_SCHEMA`].
    pub schema: String,
    /// The verdict in a sentence.
    pub verdict: String,
    /// Path of the record.
    pub record: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Start of the compared part, s of the record's clock.
    pub from_s: f64,
    /// End of the compared part, s of the record's clock.
    pub until_s: f64,
    /// Period of the simulation, s.
    pub period_s: f64,
    /// Number of points compared.
    pub samples: usize,
    /// Horizon of the short predictions, s.
    pub horizon_s: f64,
    /// True when the free run diverged, so that only short predictions could be compared.
    pub diverged: bool,
    /// Method by which the initial state was found.
    pub initial_state_method: String,
    /// Initial state of the free run, by name, SI.
    pub initial_state: BTreeMap<String, f64>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputComparison>,
    /// Outputs of the vehicle that the record does not have.
    pub not_compared: Vec<String>,
    /// Remarks on the record: gaps, uneven sampling.
    pub remarks: Vec<String>,
    /// Signals for the report.
    #[serde(skip)]
    pub series: Series,
}

/// Figures of one output, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputComparison {
    /// SI unit.
    pub unit: ShownUnit,
    /// 100 (1 - norm(y - y_sim) / norm(y - mean y)) of the free run, %; `None` when it diverged or the measured
    /// output never changes.
    pub fit: Option<f64>,
    /// Fit of the free run after the mean of the residual is subtracted, %.
    pub fit_bias_removed: Option<f64>,
    /// Root of the mean square residual.
    pub rmse: Option<f64>,
    /// Mean of the residual (measured minus simulated).
    pub bias: Option<f64>,
    /// Pearson correlation of measured and simulated values; insensitive to gain and offset.
    pub correlation: Option<f64>,
    /// Standard deviation of the noise that the vehicle file declares for the sensor.
    pub declared_noise: f64,
    /// Fit of the predictions over the horizon, %.
    pub horizon_fit: Option<f64>,
    /// Root of the mean square error of the predictions over the horizon.
    pub horizon_rmse: Option<f64>,
    /// The part of the record with the largest mean square residual.
    pub worst: Option<Interval>,
    /// Ratio of the rms residual in the last tenth of the record to the rms residual before.
    pub growth: Option<f64>,
    /// Peaks in the spectrum of the residual, strongest first.
    pub lines: Vec<Peak>,
    /// Mean square residual in twenty equal parts of the record: the quadratic error over time.
    pub quadratic_error: Vec<Interval>,
}

/// A part of the record and the mean square residual in it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Start, s of the record's clock.
    pub from_s: f64,
    /// End, s of the record's clock.
    pub until_s: f64,
    /// Mean square residual, in the squared unit of the output.
    pub mean_square: f64,
}

/// The signals of a comparison.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Time, s of the record's clock.
    pub t: Vec<f64>,
    /// Inputs: name, SI unit and applied values, one value per point.
    pub inputs: Vec<(String, ShownUnit, Vec<f64>)>,
    /// Outputs in the vehicle's order.
    pub outputs: Vec<OutputSeries>,
}

/// The signals of one output, NaN where there is no value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OutputSeries {
    /// Name of the output.
    pub name: String,
    /// Measured values, SI.
    pub measured: Vec<f64>,
    /// Values of the free run, SI.
    pub simulated: Vec<f64>,
    /// Error of the predictions over the horizon (measured minus predicted), SI.
    pub prediction_error: Vec<f64>,
}

impl Comparison {
    /// Names and figures of the outputs, in the vehicle's order.
    pub fn ordered(&self) -> impl Iterator<Item = (&str, &OutputComparison)> {
        self.series.outputs.iter().filter_map(|s| Some((s.name.as_str(), self.outputs.get(&s.name)?)))
    }
}
