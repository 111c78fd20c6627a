//! Quantities in configurations: a number in SI, or a text with its unit.

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer};
use whirlstand_msgs::units::{Quantity, Unit};

/// Takes a number in SI, or a text in the same kind of unit as one of these.
struct Written(Vec<Unit>);

impl Visitor<'_> for Written {
    type Value = f64;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let units: Vec<_> = self.0.iter().map(Unit::si_symbol).collect();
        let units = if units.is_empty() { "SI".into() } else { units.join(" or ") };
        write!(f, "a number in {units}, or a text with its unit")
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
        let mut last = Ok(quantity.si);
        for unit in &self.0 {
            match quantity.in_unit(unit) {
                Ok(_) => return Ok(quantity.si),
                Err(e) => last = Err(E::custom(e)),
            }
        }
        last
    }
}

fn units<E: Error>(texts: &[&str]) -> Result<Written, E> {
    texts.iter().map(|t| t.parse()).collect::<Result<_, _>>().map(Written).map_err(E::custom)
}

/// An angle, rad.
pub(crate) fn angle<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    deserializer.deserialize_any(units(&["rad"])?)
}

/// A value of any signal, SI.
pub(crate) fn any<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    deserializer.deserialize_any(units(&[])?)
}

/// A turn rate, rad/s.
pub(crate) fn rate<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    deserializer.deserialize_any(units(&["rad/s"])?)
}

/// A list of angles, rad.
pub(crate) fn angles<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<f64>>, D::Error> {
    #[derive(Deserialize)]
    struct One(#[serde(deserialize_with = "angle")] f64);
    let list: Option<Vec<One>> = Option::deserialize(deserializer)?;
    Ok(list.map(|l| l.into_iter().map(|o| o.0).collect()))
}

/// An acceleration, rad/s^2 or m/s^2.
pub(crate) fn acceleration<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    fn one<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
        deserializer.deserialize_any(units(&["rad/s^2", "m/s^2"])?)
    }
    #[derive(Deserialize)]
    struct One(#[serde(deserialize_with = "one")] f64);
    Ok(Option::<One>::deserialize(deserializer)?.map(|o| o.0))
}
