//! What the mirror says.

use whirlstand_vehicle::{Effect, Kind};

/// How far a finding has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Prediction has become wrong; nothing is known of the cause.
    Wrong,
    /// This is the cause, as far as the data go.
    Named,
    /// Another size, or another cause than was said before.
    Revised,
    /// What was said does not hold; prediction is still wrong.
    Withdrawn,
    /// Prediction is right again.
    Over,
}

/// A parameter with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    /// Name in the table of effects.
    pub name: &'static str,
    /// The most likely value, SI.
    pub value: f64,
    /// Lower end of the interval that holds it with 95 %.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// A cause.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// The effect, as it can be written into a vehicle file.
    pub effect: Effect,
    /// Its parameters that were estimated.
    pub values: Vec<Value>,
    /// Its probability among all that was tried.
    pub probability: f64,
    /// What the data cannot tell from it.
    pub indistinguishable: Vec<(Kind, String)>,
}

/// What the mirror says at a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Counts the changes that were seen, from 1; all that is said of one has its number.
    pub number: u64,
    /// How far it has come.
    pub stage: Stage,
    /// The step at which it is said.
    pub step: u64,
    /// The step from which on the vehicle is another, as far as is known.
    pub since: u64,
    /// The output whose prediction became wrong first.
    pub output: usize,
    /// Log-likelihood ratio of what is said against no change.
    pub evidence: f64,
    /// The cause, once it is named.
    pub cause: Option<Cause>,
}
