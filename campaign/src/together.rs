//! Correlations among the parameters of an answer, and joint draws from them.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::correlation::correlation_root;
use crate::quantity::{Quantity, Spread, Variation};

/// Correlations of the parameters' errors: row by row for an identification, pair by pair for a diagnosis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum Correlations {
    Matrix(Vec<Vec<f64>>),
    Pairs(Vec<Pair>),
}

impl Default for Correlations {
    fn default() -> Self {
        Self::Pairs(Vec::new())
    }
}

impl Correlations {
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Matrix(rows) => rows.is_empty(),
            Self::Pairs(pairs) => pairs.is_empty(),
        }
    }

    /// The element of a matrix; NaN where there is none.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        let Self::Matrix(rows) = self else { return f64::NAN };
        rows.get(i).and_then(|row| row.get(j)).copied().unwrap_or(f64::NAN)
    }

    /// The correlation of two parameters by name; a pair that is not listed is independent.
    pub fn between(&self, a: &str, b: &str) -> f64 {
        let Self::Pairs(pairs) = self else { return 0.0 };
        let is = |pair: &&Pair| {
            let [first, second] = pair.between.each_ref().map(Place::key);
            (first == a && second == b) || (first == b && second == a)
        };
        pairs.iter().find(is).map_or(0.0, |pair| pair.coefficient)
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pair {
    between: [Place; 2],
    coefficient: f64,
}

/// A parameter of a cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Place {
    effect: String,
    #[serde(rename = "where")]
    place: String,
    parameter: String,
}

impl Place {
    fn key(&self) -> String {
        key(&self.effect, &self.place, &self.parameter)
    }
}

/// Key of the parameter of a cause.
pub(crate) fn key(effect: &str, place: &str, parameter: &str) -> String {
    format!("{effect}({place}).{parameter}")
}

/// A joint quantity of these keys; `correlation` gives the correlation of two different keys by their
/// indices.
pub(crate) fn together(
    keys: Vec<String>,
    each: Vec<Spread>,
    correlation: impl Fn(usize, usize) -> f64,
) -> Result<Quantity, String> {
    let n = keys.len();
    let matrix = DMatrix::from_fn(n, n, |i, j| if i == j { 1.0 } else { correlation(i, j) });
    let root =
        correlation_root(&matrix).ok_or("the correlations of its parameters are not positive definite")?;
    Ok(Quantity { keys, variation: Variation::Joint { each, root }, levels: None })
}
