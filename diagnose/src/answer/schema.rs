//! Schema of a diagnosis, as it is written to JSON.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Vehicle;

/// Schema identifier of [`Diagnosis`].
pub const DIAGNOSIS_SCHEMA: &str = "whirlstand.diagnosis.v1";

/// Overall result of a diagnosis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No effect was accepted: the simulation agrees with the record.
    Consistent,
    /// The named causes explain the error of the simulation.
    Explained,
    /// The named causes explain a part of the error of the simulation.
    PartlyExplained,
    /// The simulation is wrong, and no effect of the table explains it.
    Unexplained,
    /// The record could not have shown most effects.
    Inconclusive,
}

/// A diagnosis: the error of a simulation, its causes, and the improvement by correcting them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// Schema identifier, [`DIAGNOSIS_SCHEMA`].
    pub schema: String,
    /// Overall result.
    pub verdict: Verdict,
    /// The verdict in a sentence.
    pub summary: String,
    /// Version of this program.
    pub version: String,
    /// Names of the logs.
    pub records: Vec<String>,
    /// True when the search was stopped early, by hand or by its time budget: the answer is then preliminary.
    #[serde(default)]
    pub partial: bool,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Sampling period, s.
    pub period_s: f64,
    /// Causes, the one with the most evidence first.
    pub causes: Vec<Cause>,
    /// Correlations of the errors of the causes' parameters, each pair once; pairs that are not listed are
    /// independent.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub correlations: Vec<Correlation>,
    /// Free parameters of the vehicle, which were fitted anew beside the causes; absent where the vehicle's values
    /// were kept.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub refitted: Vec<Refitted>,
    /// Effects that were tested and not accepted, the nearest first.
    pub rejected: Vec<Rejected>,
    /// Effects that this record could not have shown.
    pub not_testable: Vec<NotTestable>,
    /// Scores of the outputs, by output name.
    pub outputs: BTreeMap<String, OutputGain>,
    /// The part of the record that was held out for validation.
    pub heldout: HeldOut,
    /// The part of the model error that no cause explains.
    pub unexplained: Unexplained,
    /// Problems of the data themselves.
    pub data: Vec<DataFinding>,
    /// Further remarks on the diagnosis.
    pub remarks: Vec<String>,
    /// Advice on the next flight, when the record leaves something open.
    pub advice: Vec<String>,
    /// Path of the extended vehicle file, if it was written.
    pub extended_vehicle: Option<String>,
    /// The extended vehicle itself; `None` without causes.
    #[serde(skip)]
    pub extended: Option<Box<Vehicle>>,
    /// Signals for the report.
    #[serde(skip)]
    pub figures: Figures,
}

/// A named cause: an effect at a place, with its parameters and evidence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// Name of the effect in the table.
    pub effect: String,
    /// Place of the effect: an input, state, output or matrix entry.
    #[serde(rename = "where")]
    pub place: String,
    /// Parameters with 95 % intervals, SI, by name.
    pub parameters: BTreeMap<String, Estimate>,
    /// Text parameter of the effect: the vehicle of a mode transition, the source of a vibration.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub text: Option<String>,
    /// Statistical evidence for the cause.
    pub evidence: Evidence,
    /// Effects that this record cannot distinguish from the cause.
    pub indistinguishable: Vec<LookAlike>,
    /// Notes on the cause, such as aliases or the source of a tone.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub notes: Vec<String>,
}

/// The correlation of the errors of two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// The two parameters.
    pub between: [ParameterPlace; 2],
    /// Correlation coefficient, -1 to 1.
    pub coefficient: f64,
}

/// A free parameter of the vehicle before and after the fit to the record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Refitted {
    /// Name of the parameter, as `identify` gives it.
    pub parameter: String,
    /// Value in the vehicle file, SI.
    pub given: f64,
    /// Value with which the simulation fits the record, SI: that of the extended vehicle.
    pub value: f64,
    /// SI unit of both; empty for a dimensionless number.
    pub unit: String,
}

/// A parameter of a cause.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ParameterPlace {
    /// Name of the effect in the table.
    pub effect: String,
    /// Place of the effect.
    #[serde(rename = "where")]
    pub place: String,
    /// Name of the parameter.
    pub parameter: String,
}

/// A value with its 95 % interval, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Estimated value.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
    /// SI unit of value and interval; empty for a dimensionless number.
    #[serde(default)]
    pub unit: ShownUnit,
}

impl Estimate {
    /// An estimate without a unit; units are set for the whole answer later.
    pub(crate) fn new(value: f64, low: f64, high: f64) -> Self {
        Self { value, low, high, unit: ShownUnit::default() }
    }
}

/// Statistical evidence for a cause.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Gain in the Bayesian information criterion over the model without it, residuals whitened.
    pub delta_bic: f64,
    /// Gain on data left out of the fit, divided by its standard error.
    pub heldout_gain_sigma: f64,
    /// Share of the residual's power that the cause removes, 0 to 1.
    pub share_of_residual: f64,
    /// Probability of so large a gain by chance, after Holm's correction for all effects tested.
    pub p_value: f64,
    /// Detectability: squared norm of the effect's signature relative to the noise.
    pub detectability: f64,
}

/// An effect with the same signature in this record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LookAlike {
    /// Name of the effect in the table.
    pub effect: String,
    /// Place of the effect.
    #[serde(rename = "where")]
    pub place: String,
    /// Cosine of the angle between the two signatures.
    pub kappa: f64,
    /// Parameters of the effect, SI, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub parameters: BTreeMap<String, f64>,
    /// SI units of the parameters, by name; empty for a dimensionless number.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub units: BTreeMap<String, String>,
    /// The experiment that would distinguish the two effects.
    pub experiment: String,
}

/// An effect that was tested and not accepted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Name of the effect in the table.
    pub effect: String,
    /// Place of the effect.
    #[serde(rename = "where")]
    pub place: String,
    /// Gain in the Bayesian information criterion over the model without it, beside the accepted causes.
    pub delta_bic: f64,
    /// Reason for the rejection, as a sentence.
    pub why: String,
}

/// An effect that the record could not have shown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NotTestable {
    /// Name of the effect in the table.
    pub effect: String,
    /// Place of the effect.
    #[serde(rename = "where")]
    pub place: String,
    /// Reason, and which flight would show the effect.
    pub why: String,
    /// Number of effects and places that this entry stands for.
    #[serde(default)]
    pub effects: usize,
}

/// Scores of one output on held-out data, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputGain {
    /// SI unit of the output.
    pub unit: ShownUnit,
    /// Fit of the given vehicle's free run, %; `None` when the output does not change or a free run is not
    /// meaningful, as for an unstable axis.
    pub fit_before: Option<f64>,
    /// Fit of the extended vehicle's free run, %.
    pub fit_after: Option<f64>,
    /// Root of the mean square error of the given vehicle's free run.
    pub rmse_before: Option<f64>,
    /// Root of the mean square error of the extended vehicle's free run.
    pub rmse_after: Option<f64>,
    /// Fit of the given vehicle's predictions over the horizon, %.
    #[serde(default)]
    pub horizon_fit_before: Option<f64>,
    /// Fit of the extended vehicle's predictions over the horizon, %.
    #[serde(default)]
    pub horizon_fit_after: Option<f64>,
    /// Root of the mean square error of the given vehicle's predictions over the horizon.
    #[serde(default)]
    pub horizon_rmse_before: Option<f64>,
    /// Root of the mean square error of the extended vehicle's predictions over the horizon.
    #[serde(default)]
    pub horizon_rmse_after: Option<f64>,
    /// Standard deviation of the noise, which no model can explain; 0 where it is not known.
    pub noise_floor: f64,
    /// Where no noise is declared: the share of the output's power about its mean, 0 to 1, that predictions leave
    /// to the noise model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub noise_model_share: Option<f64>,
}

/// A time span of a record, s on the record's clock.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct HeldOut {
    /// Start of the span, s.
    pub from_s: f64,
    /// End of the span, s.
    pub to_s: f64,
    /// Horizon over which the outputs were predicted in the span, s, besides the free run.
    #[serde(default)]
    pub horizon_s: f64,
}

/// The part of the model error that no cause explains.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Unexplained {
    /// Share of the original residual power that is left, 0 to 1, noise not counted.
    pub share: f64,
    /// Description: channel, share, band, onset, coherent input, amplitude dependence, memory, nearest
    /// rejected effects.
    pub description: String,
}

/// A problem of the data themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataFinding {
    /// Kind of the problem: `gap`, `uneven`, `stuck`, `swapped`, `sign`, `unit`, `short`, `no_excitation`,
    /// `saturated`, `not_a_number`, `long`, `limit`, `vehicle`.
    pub kind: String,
    /// The affected channel or channels.
    #[serde(rename = "where")]
    pub place: String,
    /// The problem as a sentence, with its remedy.
    pub text: String,
    /// True when no cause can be named before the problem is fixed.
    pub blocking: bool,
}

/// Signals of a diagnosis for the report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Figures {
    /// Time of each step, s on the record's clock.
    pub t: Vec<f64>,
    /// Inputs: name, SI unit, values.
    pub inputs: Vec<(String, ShownUnit, Vec<f64>)>,
    /// Outputs in the vehicle's order.
    pub outputs: Vec<OutputFigure>,
    /// Evidence curves of the accepted and of the nearest rejected causes.
    pub evidence: Vec<EvidenceCurve>,
    /// Text of the given vehicle's file.
    pub given_vehicle: String,
}

/// Signals of one output, NaN where there is no value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OutputFigure {
    /// Name of the output.
    pub name: String,
    /// SI unit of the output.
    pub unit: ShownUnit,
    /// Measured values.
    pub measured: Vec<f64>,
    /// Free run of the given vehicle.
    pub before: Vec<f64>,
    /// Free run of the extended vehicle; empty without causes.
    pub after: Vec<f64>,
    /// Frequencies of the tones named in this output, Hz.
    pub tones: Vec<f64>,
}

/// Points of a line or a cloud: x values and y values.
pub type Points = (Vec<f64>, Vec<f64>);

/// An axis of a plot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Axis {
    /// Quantity on the axis.
    pub name: String,
    /// SI unit of the axis.
    pub unit: ShownUnit,
}

impl Axis {
    pub(crate) fn new(name: &str, unit: ShownUnit) -> Self {
        Self { name: name.into(), unit }
    }

    pub(crate) fn time(name: &str) -> Self {
        Self::new(name, ShownUnit::si("s"))
    }

    pub(crate) fn number(name: &str) -> Self {
        Self::new(name, ShownUnit::default())
    }
}

/// Evidence curve of a cause: the error of the simulation against the quantity on which the cause depends.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EvidenceCurve {
    /// Name and place of the effect.
    pub cause: String,
    /// True for an accepted cause.
    pub accepted: bool,
    /// How to read the plot, as a sentence.
    pub caption: String,
    /// The x axis.
    pub x: Axis,
    /// The y axis.
    pub y: Axis,
    /// Both axes are logarithmic.
    pub logarithmic: bool,
    /// Single samples of the record, thinned; empty where the lines suffice.
    pub cloud: Points,
    /// Line that the record shows as a whole. NaN is a gap.
    pub measured: Points,
    /// Line that the cause predicts, computed in the same way.
    pub explained: Points,
    /// Line of the given vehicle, without the cause.
    pub without: Points,
    /// Name and line of the nearest rejected rival of an accepted cause.
    pub rival: Option<(String, Points)>,
}

/// A number with at most four digits.
pub(crate) fn short(v: f64) -> String {
    whirlstand_logs::shown::number((v * 1e9).round() / 1e9)
}
