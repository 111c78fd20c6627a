//! Quantities that vary, and the values drawn for them.

use std::fmt;
use std::str::FromStr;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};

/// A number in the form of a launch file, with or without a unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub struct Number {
    /// The value, in `unit`.
    pub value: f64,
    /// The unit as it was written; empty without one.
    pub unit: String,
}

/// A number as TOML may hold it.
#[derive(Deserialize)]
#[serde(untagged)]
enum Written {
    Bare(f64),
    WithUnit(String),
    Kept { value: f64, unit: String },
}

impl TryFrom<Written> for Number {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        match written {
            Written::Bare(value) => Ok(Self { value, unit: String::new() }),
            Written::WithUnit(text) => text.parse(),
            Written::Kept { value, unit } => Ok(Self { value, unit }),
        }
    }
}

impl FromStr for Number {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        // The unit begins where no longer beginning is a number: "1e3 Hz", "5 deg/s^2", "3 eV" if there were one.
        let end = (1..=text.len()).rev().filter(|&end| text.is_char_boundary(end));
        let number = end.filter_map(|end| Some((text[..end].trim_end().parse::<f64>().ok()?, end))).next();
        match number.filter(|(value, _)| value.is_finite()) {
            Some((value, end)) => Ok(Self { value, unit: text[end..].trim().into() }),
            None => {
                Err(format!("a number with or without a unit is expected, such as \"5 deg\", not \"{text}\""))
            }
        }
    }
}

/// The value of a key in one flight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// A whole number, such as a seed.
    Whole(i64),
    /// A number.
    Number(Number),
    /// A word.
    Word(String),
}

impl Value {
    /// The value as a number, in the unit of the campaign file; `None` for a word.
    pub fn number(&self) -> Option<f64> {
        match self {
            Self::Whole(value) => Some(*value as f64),
            Self::Number(number) => Some(number.value),
            Self::Word(_) => None,
        }
    }
}

impl fmt::Display for Value {
    /// The value as the right side of `--set KEY=VALUE`, with all digits.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole(value) => write!(f, "{value}"),
            // A float in TOML has a point or an exponent.
            Self::Number(Number { value, unit }) if unit.is_empty() => write!(f, "{value:?}"),
            Self::Number(Number { value, unit }) => write!(f, "\"{value:?} {unit}\""),
            Self::Word(word) => write!(f, "{word}"),
        }
    }
}

/// A continuous distribution of one number.
#[derive(Debug, Clone, PartialEq)]
pub enum Spread {
    /// Uniform between two numbers of one unit.
    Uniform {
        /// The ends.
        ends: [f64; 2],
        /// Their unit.
        unit: String,
    },
    /// Normal distribution.
    Normal {
        /// Mean.
        mean: f64,
        /// Standard deviation, above 0.
        std: f64,
        /// Unit of both.
        unit: String,
    },
}

impl Spread {
    fn unit(&self) -> &str {
        let (Self::Uniform { unit, .. } | Self::Normal { unit, .. }) = self;
        unit
    }

    /// The quantile `p`: a share `p` of all draws is below it.
    fn at(&self, p: f64) -> Value {
        match self {
            Self::Uniform { ends: [low, high], .. } => self.number(low + p * (high - low)),
            Self::Normal { .. } => self.at_standard(quantile(p)),
        }
    }

    /// The value for the standard normal number `z`.
    fn at_standard(&self, z: f64) -> Value {
        match self {
            Self::Uniform { .. } => self.at(Normal::standard().cdf(z)),
            Self::Normal { mean, std, .. } => self.number(mean + std * z),
        }
    }

    fn number(&self, value: f64) -> Value {
        Value::Number(Number { value, unit: self.unit().into() })
    }
}

/// The variation of one key, or of several keys together.
#[derive(Debug, Clone, PartialEq)]
pub enum Variation {
    /// One key, independent of others.
    One(Spread),
    /// Several correlated keys: each has its own marginal distribution, linked by a joint normal distribution (a
    /// Gaussian copula: Cario and Nelson, INFORMS Journal on Computing 1997, "NORTA"). For normal marginals it is
    /// their joint distribution.
    Joint {
        /// Marginal distribution of each key.
        each: Vec<Spread>,
        /// Lower root of the correlations (keys x keys).
        root: DMatrix<f64>,
    },
    /// Whole numbers with equal probability, including both ends.
    Integers {
        /// First and last.
        ends: [i64; 2],
    },
    /// One of these values with equal probability.
    Among {
        /// The values.
        values: Vec<Value>,
    },
}

/// Keys of the launch file and their variation.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// Keys as `--set` takes them; more than one for [`Variation::Joint`] only.
    pub keys: Vec<String>,
    /// The variation of the keys.
    pub variation: Variation,
    /// Number of values on a grid.
    pub levels: Option<usize>,
}

impl Quantity {
    /// Number of coordinates of a point that it uses.
    pub fn coordinates(&self) -> usize {
        self.keys.len()
    }

    /// Whether it is drawn from a continuous distribution.
    pub fn is_continuous(&self) -> bool {
        !matches!(self.variation, Variation::Integers { .. } | Variation::Among { .. })
    }

    /// Its unit for each key; empty without one.
    pub fn units(&self) -> Vec<String> {
        match &self.variation {
            Variation::One(one) => vec![one.unit().into()],
            Variation::Joint { each, .. } => each.iter().map(|one| one.unit().into()).collect(),
            Variation::Among { values } => match values.first() {
                Some(Value::Number(number)) => vec![number.unit.clone()],
                _ => vec![String::new()],
            },
            Variation::Integers { .. } => vec![String::new()],
        }
    }

    /// Values at a point of the unit cube (coordinates above 0 and below 1), one for each key.
    pub fn at(&self, point: &[f64]) -> Vec<Value> {
        let first = point.first().copied().unwrap_or(0.5);
        match &self.variation {
            Variation::One(one) => vec![one.at(first)],
            Variation::Joint { each, root } => {
                let standard = DVector::from_iterator(point.len(), point.iter().map(|p| quantile(*p)));
                each.iter().zip((root * standard).iter()).map(|(one, z)| one.at_standard(*z)).collect()
            }
            Variation::Integers { ends: [low, high] } => {
                let count = (high - low) as f64 + 1.0;
                vec![Value::Whole((low + (first * count) as i64).min(*high))]
            }
            Variation::Among { values } => {
                let chosen = ((first * values.len() as f64) as usize).min(values.len() - 1);
                vec![values[chosen].clone()]
            }
        }
    }

    /// The values on a grid, in order; `None` where their number is not stated.
    pub fn grid(&self) -> Option<Vec<Value>> {
        match (&self.variation, self.levels) {
            (Variation::Among { values }, None) => Some(values.clone()),
            (Variation::Integers { ends: [low, high] }, None) => {
                Some((*low..=*high).map(Value::Whole).collect())
            }
            (Variation::One(Spread::Uniform { ends: [low, high], unit }), Some(levels)) => {
                let at = |i: usize| low + (high - low) * i as f64 / (levels.max(2) - 1) as f64;
                let value = |i| Value::Number(Number { value: at(i), unit: unit.clone() });
                Some((0..levels).map(value).collect())
            }
            _ => None,
        }
    }
}

fn quantile(p: f64) -> f64 {
    Normal::standard().inverse_cdf(p)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn numbers_have_units_or_none() {
        for (text, value, unit) in [
            ("5 deg", 5.0, "deg"),
            ("-1e3Hz", -1e3, "Hz"),
            (" 2.5 ", 2.5, ""),
            ("150 deg/s^2", 150.0, "deg/s^2"),
        ] {
            assert_eq!(text.parse::<Number>().unwrap(), Number { value, unit: unit.into() }, "{text}");
        }
        for text in ["deg", "", "nan", "inf m"] {
            assert!(text.parse::<Number>().is_err(), "{text}");
        }
    }

    #[test]
    fn values_are_written_as_set_takes_them() {
        let of = |value, unit: &str| Value::Number(Number { value, unit: unit.into() }).to_string();
        assert_eq!(of(3.0, ""), "3.0");
        assert_eq!(of(0.1, "rad"), "\"0.1 rad\"");
        assert_eq!(
            (Value::Whole(7).to_string(), Value::Word("lqr".into()).to_string()),
            ("7".into(), "lqr".into())
        );
    }

    proptest! {
        #[test]
        fn what_is_drawn_lies_where_it_may(p in 1e-9..1.0 - 1e-9f64) {
            let one = |variation| Quantity { keys: vec!["a".into()], variation, levels: None }.at(&[p]).remove(0);
            let uniform = one(Variation::One(Spread::Uniform { ends: [-2.0, 3.0], unit: "deg".into() }));
            prop_assert!((-2.0..=3.0).contains(&uniform.number().unwrap()));
            let whole = one(Variation::Integers { ends: [4, 6] });
            prop_assert!((4.0..=6.0).contains(&whole.number().unwrap()));
            let word = one(Variation::Among { values: vec![Value::Word("a".into()), Value::Word("b".into())] });
            prop_assert_eq!(word, Value::Word(if p < 0.5 { "a" } else { "b" }.into()));
        }
    }
}
