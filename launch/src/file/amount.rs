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

/// Reads a rate in Hz, or with a unit of frequency.
pub(super) fn hertz<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let unit = "Hz".parse().map_err(D::Error::custom)?;
    Amount::deserialize(deserializer)?.si(&unit).map_err(D::Error::custom)
}

/// Units of a size, and their bytes. `M` and the like are powers of ten (IEC 80000-13).
const SIZES: [(&str, u64); 7] = [
    ("B", 1),
    ("kB", 1_000),
    ("MB", 1_000_000),
    ("GB", 1_000_000_000),
    ("KiB", 1 << 10),
    ("MiB", 1 << 20),
    ("GiB", 1 << 30),
];

/// A size in bytes, or with a unit of [`SIZES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Bytes(pub u64);

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(BytesVisitor)
    }
}

struct BytesVisitor;

impl Visitor<'_> for BytesVisitor {
    type Value = Bytes;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a number of bytes, or a string with a unit such as \"500 MB\"")
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Bytes, E> {
        u64::try_from(value).map(Bytes).map_err(|_| E::custom("a size cannot be negative"))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Bytes, E> {
        Ok(Bytes(value))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Bytes, E> {
        let end = text.find(|c: char| c.is_alphabetic()).unwrap_or(text.len());
        let (number, unit) = (text[..end].trim(), text[end..].trim());
        let unit = SIZES.iter().find(|(name, _)| *name == unit);
        let value = number.parse::<f64>().ok().filter(|value| (0.0..1e18).contains(value));
        match value.zip(unit) {
            Some((value, (_, bytes))) => Ok(Bytes((value * *bytes as f64).round() as u64)),
            None => {
                let names: Vec<_> = SIZES.iter().map(|(name, _)| *name).collect();
                Err(E::custom(format!(
                    "'{text}' is not a size: a number and one of {} is expected",
                    names.join(", ")
                )))
            }
        }
    }
}
