//! What a diagnosis answers.

use std::collections::BTreeMap;
use whirlstand_logs::shown::ShownUnit;

use serde::{Deserialize, Serialize};
use whirlstand_vehicle::Vehicle;

/// Schema of [`Diagnosis`].
pub const DIAGNOSIS_SCHEMA: &str = "whirlstand.diagnosis.v1";

/// What a diagnosis comes to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// No effect passed: the simulation agrees with the record.
    Consistent,
    /// The named causes explain what the simulation got wrong.
    Explained,
    /// The named causes explain a part of it.
    PartlyExplained,
    /// Something is wrong, and no effect of the table is it.
    Unexplained,
    /// The record could not have shown an effect.
    Inconclusive,
}

/// What is wrong with a simulation, why, and what is gained by mending it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// [`DIAGNOSIS_SCHEMA`].
    pub schema: String,
    /// What it comes to.
    pub verdict: Verdict,
    /// The verdict in a sentence.
    pub summary: String,
    /// Version of this program.
    pub version: String,
    /// The logs.
    pub records: Vec<String>,
    /// True when the search was ended early, by hand or by its budget of time: then this is what was known by then.
    #[serde(default)]
    pub partial: bool,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Period, s.
    pub period_s: f64,
    /// Causes, the one with the most evidence first.
    pub causes: Vec<Cause>,
    /// How the errors of the causes' parameters hang together, each pair once; pairs that are not listed are independent.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub correlations: Vec<Correlation>,
    /// Effects that were weighed and not accepted, the nearest first.
    pub rejected: Vec<Rejected>,
    /// Effects that this record could not have shown.
    pub not_testable: Vec<NotTestable>,
    /// Figures of the outputs, by name.
    pub outputs: BTreeMap<String, OutputGain>,
    /// The part that was held out.
    pub heldout: HeldOut,
    /// What no cause explains.
    pub unexplained: Unexplained,
    /// What is wrong with the data themselves.
    pub data: Vec<DataFinding>,
    /// What else should be known.
    pub remarks: Vec<String>,
    /// What to fly next, when the record leaves something open.
    pub advice: Vec<String>,
    /// The extended vehicle file, if it was written.
    pub extended_vehicle: Option<String>,
    /// The extended vehicle itself; `None` without causes.
    #[serde(skip)]
    pub extended: Option<Box<Vehicle>>,
    /// The signals, for the report.
    #[serde(skip)]
    pub figures: Figures,
}

/// A named cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cause {
    /// Effect of the table.
    pub effect: String,
    /// Its place.
    #[serde(rename = "where")]
    pub place: String,
    /// Its parameters with 95 % intervals, SI.
    pub parameters: BTreeMap<String, Estimate>,
    /// A text that the effect carries: the vehicle of a mode transition, the source of a vibration.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub text: Option<String>,
    /// What speaks for it.
    pub evidence: Evidence,
    /// Effects that this record cannot tell from it.
    pub indistinguishable: Vec<LookAlike>,
    /// What should be known about it: aliases of a tone, where it comes from.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub notes: Vec<String>,
}

/// The correlation of the errors of two parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Correlation {
    /// The two.
    pub between: [ParameterPlace; 2],
    /// From -1 to 1.
    pub coefficient: f64,
}

/// A parameter of a cause.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ParameterPlace {
    /// Effect of the table.
    pub effect: String,
    /// Its place.
    #[serde(rename = "where")]
    pub place: String,
    /// Name of the parameter.
    pub parameter: String,
}

/// A value with its 95 % interval, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// SI unit of the three; empty for a pure number.
    #[serde(default)]
    pub unit: ShownUnit,
}

impl Estimate {
    /// An estimate whose unit is filled in with the others of the answer.
    pub(crate) fn new(value: f64, low: f64, high: f64) -> Self {
        Self { value, low, high, unit: ShownUnit::default() }
    }
}

/// What speaks for a cause.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Gain in the Bayesian information criterion over the model without it, residuals whitened.
    pub delta_bic: f64,
    /// Gain on data that were left out of the fit, over its standard error.
    pub heldout_gain_sigma: f64,
    /// Share of the residual's power that goes with it, 0 to 1.
    pub share_of_residual: f64,
    /// Probability of so much by chance, after Holm's correction for all effects that were tried.
    pub p_value: f64,
    /// Detectability: squared size of its signature over the noise.
    pub detectability: f64,
}

/// An effect that looks the same in this record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LookAlike {
    /// Effect of the table.
    pub effect: String,
    /// Its place.
    #[serde(rename = "where")]
    pub place: String,
    /// Cosine of the angle between the two signatures.
    pub kappa: f64,
    /// Its parameters, SI.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub parameters: BTreeMap<String, f64>,
    /// SI units of its parameters; empty for a pure number.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub units: BTreeMap<String, String>,
    /// What would tell them apart.
    pub experiment: String,
}

/// An effect that was weighed and not accepted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Effect of the table.
    pub effect: String,
    /// Its place.
    #[serde(rename = "where")]
    pub place: String,
    /// Gain in the Bayesian information criterion over the model without it, beside the accepted causes.
    pub delta_bic: f64,
    /// Why not, in a sentence.
    pub why: String,
}

/// An effect that the record could not have shown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NotTestable {
    /// Effect of the table.
    pub effect: String,
    /// Its place.
    #[serde(rename = "where")]
    pub place: String,
    /// Why not, and what to fly.
    pub why: String,
    /// How many effects at how many places this stands for.
    #[serde(default)]
    pub effects: usize,
}

/// Figures of one output on held-out data, SI.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputGain {
    /// SI unit.
    pub unit: ShownUnit,
    /// Fit of the given vehicle's free run, %; `None` when the output does not change or a free run means nothing, as of an
    /// unstable axis.
    pub fit_before: Option<f64>,
    /// Fit of the extended vehicle's free run, %.
    pub fit_after: Option<f64>,
    /// Root of the mean square error of the given vehicle's free run.
    pub rmse_before: Option<f64>,
    /// The same of the extended vehicle.
    pub rmse_after: Option<f64>,
    /// Fit of the given vehicle's predictions over the horizon, %.
    #[serde(default)]
    pub horizon_fit_before: Option<f64>,
    /// The same of the extended vehicle.
    #[serde(default)]
    pub horizon_fit_after: Option<f64>,
    /// Root of the mean square error of the given vehicle's predictions over the horizon.
    #[serde(default)]
    pub horizon_rmse_before: Option<f64>,
    /// The same of the extended vehicle.
    #[serde(default)]
    pub horizon_rmse_after: Option<f64>,
    /// Standard deviation of the noise, which no model can explain.
    pub noise_floor: f64,
    /// Where no noise is declared: the share of the output's power about its mean, 0 to 1, that predictions leave
    /// to the noise model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub noise_model_share: Option<f64>,
}

/// A part of a record, s of its clock.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct HeldOut {
    /// Start.
    pub from_s: f64,
    /// End.
    pub to_s: f64,
    /// How far ahead the outputs were predicted there, s, beside the free run.
    #[serde(default)]
    pub horizon_s: f64,
}

/// What no cause explains.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Unexplained {
    /// Share of the residual's power before, 0 to 1, noise not counted.
    pub share: f64,
    /// Channel, share, band, onset, coherent input, amplitude dependence, memory, nearest rejected names.
    pub description: String,
}

/// Something wrong with the data themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DataFinding {
    /// What: `gap`, `uneven`, `stuck`, `swapped`, `sign`, `unit`, `short`, `no_excitation`, `saturated`, `not_a_number`,
    /// `long`, `limit`, `vehicle`.
    pub kind: String,
    /// The channel or channels.
    #[serde(rename = "where")]
    pub place: String,
    /// It in a sentence, with what to do.
    pub text: String,
    /// True when no cause can be named before it is mended.
    pub blocking: bool,
}

/// The signals of a diagnosis, for the report.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Figures {
    /// Time, s of the record's clock.
    pub t: Vec<f64>,
    /// Inputs: name, SI unit, values.
    pub inputs: Vec<(String, ShownUnit, Vec<f64>)>,
    /// Outputs in the vehicle's order.
    pub outputs: Vec<OutputFigure>,
    /// Evidence curves: for the accepted and the nearest rejected causes.
    pub evidence: Vec<EvidenceCurve>,
    /// The given vehicle as a file.
    pub given_vehicle: String,
}

/// The signals of one output, NaN where there is none.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OutputFigure {
    /// Name.
    pub name: String,
    /// SI unit.
    pub unit: ShownUnit,
    /// Measured.
    pub measured: Vec<f64>,
    /// Free run of the given vehicle.
    pub before: Vec<f64>,
    /// Free run of the extended vehicle; empty without causes.
    pub after: Vec<f64>,
    /// Frequencies of named tones in this output, Hz.
    pub tones: Vec<f64>,
}

/// Points of a line or a cloud: values below and at the side.
pub type Points = (Vec<f64>, Vec<f64>);

/// An axis of a plot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Axis {
    /// What is on it.
    pub name: String,
    /// SI unit.
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

/// What the record shows of a cause: what is missing from the simulation against what the cause depends on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EvidenceCurve {
    /// Effect and place.
    pub cause: String,
    /// True for an accepted cause.
    pub accepted: bool,
    /// How to read it, in a sentence.
    pub caption: String,
    /// The axis below.
    pub x: Axis,
    /// The axis at the side.
    pub y: Axis,
    /// Both axes are logarithmic.
    pub logarithmic: bool,
    /// Single samples of the record, thinned; empty where lines say it all.
    pub cloud: Points,
    /// What the record says on the whole. NaN is a gap.
    pub measured: Points,
    /// What the cause says, treated in the same way.
    pub explained: Points,
    /// What the given vehicle says: without the cause.
    pub without: Points,
    /// The nearest rejected rival of an accepted cause, and what it says.
    pub rival: Option<(String, Points)>,
}

/// Four digits at most.
pub(crate) fn short(v: f64) -> String {
    whirlstand_logs::shown::number((v * 1e9).round() / 1e9)
}
