//! The result of an identification as data.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Vehicle;

use super::options::Method;
use super::pem::Noise;

/// Schema of [`Identification`].
pub const IDENTIFICATION_SCHEMA: &str = "whirlstand.identification.v1";

/// A fitted vehicle, how sure it is, and how well it fits the records.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identification {
    /// Always [`IDENTIFICATION_SCHEMA`].
    pub schema: String,
    /// The result in a sentence.
    pub verdict: String,
    /// True when the search was ended early, by hand or by its budget of time: then this is the best that was found by then.
    #[serde(default)]
    pub partial: bool,
    /// Name of the vehicle.
    pub vehicle: String,
    /// How the cost was minimised.
    pub method: Method,
    /// How residuals were modelled.
    pub noise: Noise,
    /// True when a controller was in the loop.
    pub closed_loop: bool,
    /// Seed of everything random.
    pub seed: u64,
    /// Version of this program.
    pub version: String,
    /// The data.
    pub data: Vec<DataPart>,
    /// Time between two steps, s.
    pub period_s: f64,
    /// How the search ended.
    pub search: SearchSummary,
    /// Fitted parameters.
    pub parameters: Vec<ParameterAnswer>,
    /// Correlations of the fitted parameters, in their order, row after row.
    pub correlations: Vec<Vec<f64>>,
    /// Parameters that the data do not determine, fixed.
    pub fixed: Vec<FixedAnswer>,
    /// Poles of the fitted model.
    pub poles: Vec<Pole>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputAnswer>,
    /// False when the standard errors are too small because something acted in the record that the model does not have, and
    /// when the search was ended before its minimum.
    pub standard_errors_hold: bool,
    /// Stretches of the identification data where something acts that the model does not have.
    pub disturbed: Vec<Disturbed>,
    /// What else should be known.
    pub remarks: Vec<String>,
    /// The fitted vehicle file, if it was written.
    pub fitted_vehicle: Option<String>,
    /// The fitted vehicle itself.
    #[serde(skip)]
    pub fitted: Option<Box<Vehicle>>,
    /// The signals, for the report.
    #[serde(skip)]
    pub series: Vec<PartSeries>,
}

/// A part of a log.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// The file.
    pub file: String,
    /// SHA-256 of the file, hexadecimal; empty for data that came from no file.
    pub sha256: String,
}

/// One stretch of data and what it served for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataPart {
    /// Where the record was read from.
    pub log: Log,
    /// Start, s of the record's clock.
    pub from_s: f64,
    /// End, s of the record's clock.
    pub until_s: f64,
    /// Number of steps.
    pub samples: usize,
    /// Identification or control.
    pub role: Role,
    /// State at the start, by name, SI.
    pub initial_state: BTreeMap<String, f64>,
    /// Constant error of the outputs, by name, SI; empty when none was estimated.
    pub offsets: BTreeMap<String, f64>,
}

/// What data served for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The parameters were fitted to it.
    Identification,
    /// It was held out to check the fit.
    Control,
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SearchSummary {
    /// True when the search ended at a minimum.
    pub converged: bool,
    /// Number of steps of the search.
    pub iterations: usize,
    /// Number of evaluations of the cost, those of the genetic algorithm included.
    pub evaluations: usize,
    /// Cost at the end: for `ga` the mean of the normalised mean square errors, else the negative log-likelihood.
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
    /// Least value allowed.
    pub lower: f64,
    /// Greatest value allowed.
    pub upper: f64,
    /// True when the value lies at one of its bounds.
    pub at_bound: bool,
    /// Unit of the value, its error and its bounds; empty for a pure number.
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
    /// Name.
    pub name: String,
    /// The value at which it was fixed.
    pub value: f64,
    /// Unit of the value; empty for a pure number.
    #[serde(default)]
    pub unit: String,
    /// Why the data do not determine it.
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
    /// SI unit.
    pub unit: ShownUnit,
    /// Figures on the data that were fitted.
    pub identification: Option<Quality>,
    /// Figures on the data that were held out.
    pub control: Option<Quality>,
    /// Standard deviation of the part of the output that cannot be predicted one step ahead.
    pub noise_std: f64,
    /// Order of the noise's autoregressive model; 0 for white noise and for Kalman's form.
    pub noise_order: usize,
    /// Whether the one-step residuals are white.
    pub whiteness: Option<Whiteness>,
}

/// How well an output is repeated.
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

/// A stretch where one-step residuals are far greater than elsewhere: a gust, a fault.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Disturbed {
    /// Start, s of the record's clock.
    pub from_s: f64,
    /// End, s of the record's clock.
    pub until_s: f64,
    /// The output whose residuals stand out most.
    pub output: String,
    /// Root mean square of the residuals of that output in the stretch, over their usual size.
    pub ratio: f64,
}

/// Ljung and Box's test on the one-step residuals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Whiteness {
    /// Number of lags in the test.
    pub lags: usize,
    /// Probability of a statistic as great from white noise.
    pub p_value: f64,
    /// Autocorrelation of the greatest magnitude at a lag from 1 on.
    pub greatest: f64,
    /// True when the residuals pass at 1 %.
    pub white: bool,
    /// Autocorrelation at the lags from 1 on.
    pub autocorrelation: Vec<f64>,
    /// White noise stays within this at 99 % of the lags.
    pub bound: f64,
}

/// The signals of one part of the data.
#[derive(Debug, Clone, PartialEq)]
pub struct PartSeries {
    /// Identification or control.
    pub role: Role,
    /// Where it was read from.
    pub origin: String,
    /// Time, s of the record's clock.
    pub t: Vec<f64>,
    /// Period, s.
    pub period_s: f64,
    /// Inputs: name, SI unit, one value a step.
    pub inputs: Vec<(String, ShownUnit, Vec<f64>)>,
    /// Fitted outputs.
    pub outputs: Vec<OutputSeries>,
}

/// The signals of one output, SI; NaN where there is no value.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputSeries {
    /// Name.
    pub name: String,
    /// SI unit.
    pub unit: ShownUnit,
    /// Measured values.
    pub measured: Vec<f64>,
    /// Values of the free-running simulation, offset included.
    pub simulated: Vec<f64>,
}
