//! A drafted vehicle as data and as text.

use serde::Serialize;
use whirlstand_logs::shown::{number, shown};
use whirlstand_vehicle::Intersample;

use super::flown::{Flown, FlownIn};
use super::structure::Structure;

/// Schema identifier of [`Draft`].
pub const DRAFT_SCHEMA: &str = "whirlstand.vehicle_draft.v1";

/// A vehicle drafted from a record, with its prediction errors on held-out data.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Draft {
    /// Schema identifier, always [`DRAFT_SCHEMA`].
    pub schema: String,
    /// Path of the log, or of several one after the other, with a comma between two.
    pub log: String,
    /// Name of the vehicle.
    pub vehicle: String,
    /// Time between two steps of the fit, s.
    pub period_s: f64,
    /// The axes, in the order of the file.
    pub axes: Vec<AxisAnswer>,
    /// Angles that are integrals of rates.
    pub angles: Vec<String>,
    /// Chosen signals: the vehicle's name, the log's name, and the reason.
    pub signals: Vec<SignalAnswer>,
    /// Outputs that belong to no axis, each with the reason.
    pub left_out: Vec<LeftOut>,
    /// Numbers that stand for missing values, and rows that are left out, as sentences.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing_values: Vec<String>,
    /// The part of the log in which the vehicle flies, where that is not all of it.
    pub flown: Option<Flown>,
    /// The same for each of several logs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub flown_in: Vec<FlownIn>,
    /// Path of the vehicle file, if it was written.
    pub vehicle_file: Option<String>,
    /// The text of the vehicle file.
    #[serde(skip)]
    pub toml: String,
}

/// An axis: an output, the input that drives it, and the fitted structure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisAnswer {
    /// Name of the output.
    pub output: String,
    /// SI unit of the output.
    pub unit: String,
    /// Name of the input.
    pub input: String,
    /// Structure of the axis.
    pub structure: Structure,
    /// What the input does between its samples: `zoh` (held) or `foh` (straight to the next).
    pub intersample: &'static str,
    /// The structure in words.
    pub words: String,
    /// Fitted parameters, SI.
    pub parameters: Vec<ParameterAnswer>,
    /// Scores of the predictions of held-out data.
    pub heldout: HeldOut,
    /// All structures that were tried, the simplest first.
    pub tried: Vec<TriedAnswer>,
}

/// A structure that was tried.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TriedAnswer {
    /// The structure in words.
    pub words: String,
    /// Root mean square error of its predictions of held-out data, SI.
    pub rmse: f64,
}

/// A fitted parameter, SI.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParameterAnswer {
    /// Name in the vehicle file, as `A[1,1]` or `input_delay(u_roll).delay_s`.
    pub name: String,
    /// Estimated value.
    pub value: f64,
    /// SI unit of the value and its error; empty for a dimensionless number.
    pub unit: String,
    /// Standard error; `None` for one that the data do not determine.
    pub standard_error: Option<f64>,
    /// True for a value at an end of the range in which it was searched: the record calls for more than the structure allows.
    pub at_bound: bool,
}

/// Scores of predictions of held-out data.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldOut {
    /// Prediction horizon, s.
    pub horizon_s: f64,
    /// Length of the held-out data, s.
    pub seconds: f64,
    /// 100 (1 - root mean square error / spread of the output), %.
    pub fit: f64,
    /// Fit of a prediction from the output's own past alone, %.
    pub own_past_fit: f64,
    /// Fit of the model with an autoregression of its innovations, %: where it is well above its own, the sensors or their
    /// noise have a memory that the model lacks.
    pub completed_fit: f64,
    /// Root mean square error of the predictions, SI.
    pub rmse: f64,
}

/// A chosen signal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SignalAnswer {
    /// Name in the vehicle.
    pub name: String,
    /// Name in the log.
    pub source: String,
    /// Reason for the choice.
    pub why: String,
}

/// An output that belongs to no axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Name in the vehicle.
    pub output: String,
    /// Reason, as a sentence.
    pub why: String,
}

impl AxisAnswer {
    /// The input, with what it does between its samples where it is not held.
    pub fn driven_by(&self) -> String {
        let shown = if self.intersample == Intersample::Held.name() { "" } else { " (foh)" };
        format!("{}{shown}", self.input)
    }

    /// The held-out predictions in a sentence.
    pub fn sentence(&self) -> String {
        let h = &self.heldout;
        format!(
            "{} {} s ahead on {} s of held-out data: fit {:.1} % ({:.1} % from its own past alone, {:.1} % with a \
             memory of its errors), error {}",
            self.output,
            number(h.horizon_s),
            number(h.seconds),
            h.fit,
            h.own_past_fit,
            h.completed_fit,
            shown(h.rmse, &self.unit)
        )
    }
}

impl ParameterAnswer {
    /// The value with its standard error, as text.
    pub fn sentence(&self) -> String {
        // In SI, as all units of a drafted file are.
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        let value = number(self.value);
        let bound = if self.at_bound { " (at the end of its range)" } else { "" };
        match self.standard_error {
            Some(error) => format!("{} = {value} ± {}{unit}{bound}", self.name, number(error)),
            None => format!("{} = {value}{unit}, not determined by the record", self.name),
        }
    }
}

impl Draft {
    /// The parts of the logs in which the vehicle flies, as sentences.
    pub fn parts(&self) -> impl Iterator<Item = String> {
        self.flown.iter().map(Flown::sentence).chain(self.flown_in.iter().map(FlownIn::sentence))
    }

    /// The draft for the terminal.
    pub fn text(&self) -> String {
        let mut text =
            format!("{}  drafted from {}, steps of {} s\n", self.vehicle, self.log, number(self.period_s));
        let mut row = |head: &str, body: String| text.push_str(&format!("{head:<9} {body}\n"));
        for part in self.parts() {
            row("part", part);
        }
        for s in &self.signals {
            let from = if s.name == s.source { String::new() } else { format!(" = {}", s.source) };
            row("signal", format!("{}{from}  {}", s.name, s.why));
        }
        for axis in &self.axes {
            row("axis", format!("{} from {}: {}", axis.output, axis.driven_by(), axis.words));
            let values: Vec<String> = axis.parameters.iter().map(ParameterAnswer::sentence).collect();
            row("", values.join(", "));
            row("held out", axis.sentence());
        }
        for angle in &self.angles {
            row("angle", format!("{angle}, the integral of its rate"));
        }
        for left in &self.left_out {
            row("left out", format!("{}: {}", left.output, left.why));
        }
        for missing in &self.missing_values {
            row("missing", missing.clone());
        }
        if let Some(path) = &self.vehicle_file {
            row("vehicle", path.clone());
        }
        text
    }
}
