//! A diagnosis, read from its JSON (`whirlstand.diagnosis.v1`), so that the judged data are those that a user
//! would read.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

/// A diagnosis.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Diagnosis {
    /// One of: consistent, explained, partly_explained, unexplained, inconclusive.
    pub verdict: String,
    /// Accepted causes, in the order of the diagnosis.
    #[serde(default)]
    pub causes: Vec<Cause>,
    /// Error figures of every output.
    #[serde(default)]
    pub outputs: BTreeMap<String, OutputFigures>,
    /// The part of the record that is held out from the identification.
    pub heldout: Option<Heldout>,
}

/// A named cause.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Cause {
    /// Name of the effect.
    pub effect: String,
    /// Place at which the effect acts.
    #[serde(rename = "where")]
    pub place: String,
    /// Parameters by name: numbers with their intervals, and texts, such as `to`, unchanged.
    #[serde(default)]
    pub parameters: BTreeMap<String, Value>,
    /// Target vehicle of a mode transition, where it is not among the parameters.
    #[serde(default)]
    pub to: Option<String>,
    /// Causes that this record cannot distinguish from this one.
    #[serde(default)]
    pub indistinguishable: Vec<Cause>,
}

/// A parameter with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Estimate {
    pub value: f64,
    pub interval: Option<(f64, f64)>,
}

/// Error figures of an output, SI.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct OutputFigures {
    /// Root mean square of the held-out error of the extended vehicle.
    pub rmse_after: Option<f64>,
}

/// Held-out time span, s.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Heldout {
    /// Start, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
}

impl Cause {
    /// The numeric parameter `name`, with its interval if the JSON gives one.
    pub(crate) fn estimate(&self, name: &str) -> Option<Estimate> {
        let entry = self.parameters.get(name)?;
        if let Some(value) = entry.as_f64() {
            return Some(Estimate { value, interval: None });
        }
        let field = |key: &str| entry.get(key).and_then(Value::as_f64);
        Some(Estimate { value: field("value")?, interval: field("low").zip(field("high")) })
    }

    /// The target vehicle of a mode transition.
    pub(crate) fn successor(&self) -> Option<&str> {
        let listed = self.parameters.get("to").and_then(|t| t.as_str().or_else(|| t.get("value")?.as_str()));
        self.to.as_deref().or(listed)
    }
}
