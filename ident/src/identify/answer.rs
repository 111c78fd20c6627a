//! Result of an identification as data.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Vehicle;

use super::options::Method;
use super::pem::Noise;

/// Schema identifier of [`Identification`].
pub const IDENTIFICATION_SCHEMA: &str = "whirlstand.identification.v1";

/// Result of an identification: the fitted vehicle, its accuracy, and its fit to the records.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identification {
    /// Schema identifier, always [`IDENTIFICATION_SCHEMA`].
    pub schema: String,
    /// The result as a sentence.
    pub verdict: String,
    /// True when the search was stopped early, by hand or by its time budget: the answer is then the best
    /// found so far.
    #[serde(default)]
    pub partial: bool,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Minimisation method.
    pub method: Method,
    /// Noise model of the residuals.
    pub noise: Noise,
    /// States on which a force that nobody measured wanders, estimated beside the parameters (noise `kalman`).
    #[serde(default)]
    pub wandering_forces: Vec<String>,
    /// True when a controller was in the loop.
    pub closed_loop: bool,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Version of this program.
    pub version: String,
    /// The parts of the data.
    pub data: Vec<DataPart>,
    /// Time between two steps, s.
    pub period_s: f64,
    /// Effort and success of the search.
    pub search: SearchSummary,
    /// Fitted parameters.
    pub parameters: Vec<ParameterAnswer>,
    /// Correlation matrix of the fitted parameters, in their order, row after row.
    pub correlations: Vec<Vec<f64>>,
    /// Parameters that the data do not determine, and that were fixed.
    pub fixed: Vec<FixedAnswer>,
    /// Poles of the fitted model.
    pub poles: Vec<Pole>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputAnswer>,
    /// False when the standard errors are too small because an unmodelled disturbance is in the record, or
    /// when the search was stopped before its minimum.
    pub standard_errors_hold: bool,
    /// Stretches of the identification data with an unmodelled disturbance.
    pub disturbed: Vec<Disturbed>,
    /// Further remarks on the result.
    pub remarks: Vec<String>,
    /// Path of the fitted vehicle file, if it was written.
    pub fitted_vehicle: Option<String>,
    /// The fitted vehicle itself.
    #[serde(skip)]
    pub fitted: Option<Box<Vehicle>>,
    /// Signals for the report.
    #[serde(skip)]
    pub series: Vec<PartSeries>,
}

/// A log file with its checksum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// Path of the file.
    pub file: String,
    /// SHA-256 of the file, hexadecimal; empty for data that came from no file.
    pub sha256: String,
}

/// A part of the data and its role.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataPart {
    /// Log from which the part was read.
    pub log: Log,
    /// Start, s of the record's clock.
    pub from_s: f64,
    /// End, s of the record's clock.
    pub until_s: f64,
    /// Number of steps.
    pub samples: usize,
    /// Role of the part: identification or control.
    pub role: Role,
    /// Initial state of the part, by name, SI.
    pub initial_state: BTreeMap<String, f64>,
    /// Offsets of the outputs, by name, SI; empty when none were estimated.
    pub offsets: BTreeMap<String, f64>,
}

/// Role of a part of the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Data to which the parameters were fitted.
    Identification,
    /// Data held out for validation.
    Control,
}

/// Effort and success of a search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SearchSummary {
    /// True when the search ended at a minimum.
    pub converged: bool,
    /// Number of steps of the search.
    pub iterations: usize,
    /// Number of evaluations of the cost, those of the genetic algorithm included.
    pub evaluations: usize,
    /// Final cost: for `ga` the mean of the normalised mean square errors, else the negative log-likelihood.
    pub cost: f64,
    /// Wall-clock time, s.
    pub seconds: f64,
}

/// A fitted parameter, in the units of the vehicle file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterAnswer {
    /// Name, as `A[2,1]` or `input_delay(u_roll).delay_s`.
    pub name: String,
    /// Estimated value.
    pub value: f64,
    /// Standard error of the value; `None` where the method gives none.
    pub standard_error: Option<f64>,
    /// Lower bound.
    pub lower: f64,
    /// Upper bound.
    pub upper: f64,
    /// True when the value lies at one of its bounds.
    pub at_bound: bool,
    /// Unit of the value, its error and its bounds; empty for a dimensionless number.
    #[serde(default)]
    pub unit: String,
    /// Estimated value in SI.
    pub value_si: f64,
    /// SI unit of `value_si`.
    #[serde(default)]
    pub unit_si: String,
}

/// A parameter that was fixed, in the units of the vehicle file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FixedAnswer {
    /// Name of the parameter.
    pub name: String,
    /// Value at which the parameter was fixed.
    pub value: f64,
    /// Unit of the value; empty for a dimensionless number.
    #[serde(default)]
    pub unit: String,
    /// Reason why the data do not determine the parameter.
    pub why: String,
}

/// A pole of the model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pole {
    /// Real part, 1/s.
    pub re: f64,
    /// Imaginary part, rad/s.
    pub im: f64,
    /// Natural frequency, Hz.
    pub frequency_hz: f64,
    /// Damping ratio; 1 for a real stable pole.
    pub damping_ratio: f64,
}

/// Figures of one output, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputAnswer {
    /// SI unit of the output.
    pub unit: ShownUnit,
    /// Figures on the identification data.
    pub identification: Option<Quality>,
    /// Figures on the held-out data.
    pub control: Option<Quality>,
    /// Standard deviation of the part of the output that cannot be predicted one step ahead.
    pub noise_std: f64,
    /// Order of the autoregressive noise model; 0 for white noise and for the innovations form.
    pub noise_order: usize,
    /// Whiteness test of the one-step residuals.
    pub whiteness: Option<Whiteness>,
}

/// Quality of a model's reproduction of an output.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// 100 (1 - norm(y - y_sim) / norm(y - mean y)) of the free-running simulation, %.
    pub free_run_fit: Option<f64>,
    /// Fit of the free-running simulation after the mean of the residual is subtracted, %.
    pub free_run_fit_bias_removed: Option<f64>,
    /// Root of the mean square error of the free-running simulation.
    pub free_run_rmse: Option<f64>,
    /// Fit of the prediction one step ahead, %.
    pub one_step_fit: Option<f64>,
}

/// A stretch with one-step residuals far larger than elsewhere: a gust, a fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Disturbed {
    /// Start, s of the record's clock.
    pub from_s: f64,
    /// End, s of the record's clock.
    pub until_s: f64,
    /// The output with the most unusual residuals.
    pub output: String,
    /// Root mean square of that output's residuals in the stretch, relative to its usual value.
    pub ratio: f64,
}

/// Ljung-Box test of the one-step residuals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Whiteness {
    /// Number of lags in the test.
    pub lags: usize,
    /// Probability of at least this test statistic for white noise.
    pub p_value: f64,
    /// Autocorrelation of largest magnitude at the lags from 1 on.
    pub greatest: f64,
    /// True when the residuals pass the test at 1 %.
    pub white: bool,
    /// Autocorrelation at the lags from 1 on.
    pub autocorrelation: Vec<f64>,
    /// Bound within which the autocorrelation of white noise stays at 99 % of the lags.
    pub bound: f64,
}

/// Signals of one part of the data.
#[derive(Debug, Clone, PartialEq)]
pub struct PartSeries {
    /// Role of the part: identification or control.
    pub role: Role,
    /// Path of the record.
    pub origin: String,
    /// Time, s of the record's clock.
    pub t: Vec<f64>,
    /// Sampling period, s.
    pub period_s: f64,
    /// Inputs: name, SI unit, one value per step.
    pub inputs: Vec<(String, ShownUnit, Vec<f64>)>,
    /// Fitted outputs.
    pub outputs: Vec<OutputSeries>,
}

/// The signals of one output, SI; NaN where there is no value.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputSeries {
    /// Name of the output.
    pub name: String,
    /// SI unit of the output.
    pub unit: ShownUnit,
    /// Measured values.
    pub measured: Vec<f64>,
    /// Values of the free-running simulation, including the estimated offset.
    pub simulated: Vec<f64>,
}
