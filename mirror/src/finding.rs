//! Findings of the mirror.

use whirlstand_vehicle::{Effect, Kind};

/// Stage of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// The prediction has become wrong; the cause is unknown.
    Wrong,
    /// A cause is named, as far as the data allow.
    Named,
    /// The size or the cause differs from the one named before.
    Revised,
    /// The named cause is rejected; the prediction is still wrong.
    Withdrawn,
    /// The prediction is right again.
    Over,
}

/// A parameter with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    /// Name in the table of effects.
    pub name: &'static str,
    /// The most likely value, SI.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub low: f64,
    /// Upper end of the 95 % interval.
    pub high: f64,
}

/// A named cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// The effect, as it can be written into a vehicle file.
    pub effect: Effect,
    /// The estimated parameters.
    pub values: Vec<Value>,
    /// Posterior probability of the cause among all candidates.
    pub probability: f64,
    /// Kinds and locations of the effects that the data cannot distinguish from it.
    pub indistinguishable: Vec<(Kind, String)>,
}

/// A finding of the mirror at a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Number of the detected change, from 1; all findings on one change have the same number.
    pub number: u64,
    /// Stage of the finding.
    pub stage: Stage,
    /// Step of the finding.
    pub step: u64,
    /// Estimated step of the onset.
    pub since: u64,
    /// The output whose prediction became wrong first.
    pub output: usize,
    /// Log-likelihood ratio of the finding against no change.
    pub evidence: f64,
    /// The cause, once it is named.
    pub cause: Option<Cause>,
}
