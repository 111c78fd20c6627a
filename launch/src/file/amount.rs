//! A quantity in a launch file: a number in SI, or a string with a unit.

use serde::de::{Deserialize, Deserializer, Error, Visitor};
use whirlstand_msgs::units::{Quantity, Unit, UnitError};

/// A number in SI, or a number with its unit.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Amount {
    /// SI, unit not written.
    Si(f64),
    /// Written with a unit, such as `"5 deg"`.
    Written(Quantity),
}

impl Amount {
    /// The value in SI, checked against the unit that is expected here (itself SI, or any unit of the same kind).
    ///
    /// # Errors
    /// When the written unit measures something else.
    pub fn si(&self, expected: &Unit) -> Result<f64, UnitError> {
        match self {
            Self::Si(value) => Ok(*value),
            Self::Written(quantity) => quantity.in_unit(expected).map(|_| quantity.si),
        }
    }
}

impl<'de> Deserialize<'de> for Amount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(AmountVisitor)
    }
}

struct AmountVisitor;

impl Visitor<'_> for AmountVisitor {
    type Value = Amount;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a number in SI, or a string with a unit such as \"5 deg\"")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Amount, E> {
        if value.is_finite() { Ok(Amount::Si(value)) } else { Err(E::custom("the number must be finite")) }
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Amount, E> {
        Ok(Amount::Si(value as f64))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Amount, E> {
        Ok(Amount::Si(value as f64))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Amount, E> {
        text.parse().map(Amount::Written).map_err(E::custom)
    }
}

/// A time in seconds, or with a unit of time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Seconds(pub f64);

impl<'de> Deserialize<'de> for Seconds {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Amount::deserialize(deserializer)?.si(&Unit::SECOND).map(Self).map_err(D::Error::custom)
    }
}
