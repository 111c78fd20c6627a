//! Quantities in configurations: a number in SI, or a text with its unit.

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer};
use whirlstand_msgs::units::{Quantity, Unit};

struct Written(Unit);

impl Visitor<'_> for Written {
    type Value = f64;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "a number in {0}, or a text such as \"5 {0}\"", self.0.si_symbol())
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<f64, E> {
        Ok(value)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<f64, E> {
        let quantity: Quantity = text.parse().map_err(E::custom)?;
        quantity.in_unit(&self.0).map_err(E::custom)?;
        Ok(quantity.si)
    }
}

/// An angle, rad.
pub(crate) fn angle<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let unit = "rad".parse().map_err(D::Error::custom)?;
    deserializer.deserialize_any(Written(unit))
}

/// A list of angles, rad.
pub(crate) fn angles<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<f64>>, D::Error> {
    #[derive(Deserialize)]
    struct One(#[serde(deserialize_with = "angle")] f64);
    let list: Option<Vec<One>> = Option::deserialize(deserializer)?;
    Ok(list.map(|l| l.into_iter().map(|o| o.0).collect()))
}
