//! Unit of a signal, with its text in the file.

use std::fmt;
use std::str::FromStr;

use whirlstand_msgs::units::{Dimension, ShownUnit, Unit, UnitError, two_readings};

/// A unit with the text that declares it.
#[derive(Debug, Clone)]
pub struct SignalUnit {
    text: String,
    unit: Unit,
    /// True for a unit that no file declares: that of an axis whose table names no unit.
    implied: bool,
}

impl SignalUnit {
    /// Dimension of the unit.
    pub fn dimension(&self) -> Dimension {
        self.unit.dimension()
    }

    /// SI value of one unit.
    pub fn factor(&self) -> f64 {
        self.unit.factor()
    }

    /// The unit itself.
    pub fn unit(&self) -> &Unit {
        &self.unit
    }

    /// Symbol of the SI unit in which values are held in memory; empty for a dimensionless number.
    pub fn si_symbol(&self) -> String {
        self.unit.si_symbol()
    }

    /// Unit in which values are shown to a reader: as the file declares it; degrees for an angle that no file
    /// declares.
    pub fn shown(&self) -> ShownUnit {
        if self.implied {
            ShownUnit::of(&self.si_symbol())
        } else {
            ShownUnit::declared(&self.unit, &self.text)
        }
    }

    /// True for a dimensionless number without another notation such as per cent.
    pub fn is_one(&self) -> bool {
        self.unit == Unit::ONE
    }

    /// The unit of a signal that no file declares, as it is held in memory.
    pub(crate) fn implied(mut self) -> Self {
        self.implied = true;
        self
    }

    /// Reason why a number without a unit is ambiguous for this signal, with both readings; `None` where it
    /// is not.
    pub fn two_readings(&self, value: f64) -> Option<String> {
        if !self.implied {
            return two_readings(value, &self.unit, Some(&self.text));
        }
        // SI is not declared, and an angle is more often meant in degrees.
        let symbol = self.text.replacen("rad", "deg", 1);
        two_readings(value, &symbol.parse().ok()?, Some(&symbol))
    }

    /// The unit of the signal's derivative.
    pub(crate) fn per_second(&self) -> Self {
        let Some(unit) = self.unit.times(&Unit::SECOND, -1) else { return self.clone() };
        let text = self.text.trim();
        let power = text.rsplit_once("/s^").and_then(|(head, power)| Some((head, power.parse::<u8>().ok()?)));
        let nice = match (text, power) {
            ("" | "-" | "1", _) => "1/s".into(),
            (_, Some((head, power))) => format!("{head}/s^{}", power + 1),
            _ if text.ends_with("/s") => format!("{text}^2"),
            _ => format!("{text}/s"),
        };
        let text = if nice.parse() == Ok(unit) { nice } else { format!("{text}/s") };
        Self { text, unit, implied: self.implied }
    }

    /// This unit divided by another, with its text where one can be written: units have no brackets.
    pub(crate) fn over(&self, other: &Self) -> (Unit, Option<String>) {
        if other.is_one() {
            return (self.unit, Some(self.text.clone()));
        }
        let Some(unit) = self.unit.times(&other.unit, -1) else { return (self.unit, None) };
        let text = format!("{}/{}", self.text, other.text);
        let reads_back = text.parse::<Unit>().is_ok_and(|read| {
            read.dimension() == unit.dimension() && (read.factor() / unit.factor() - 1.0).abs() < 1e-12
        });
        (unit, reads_back.then_some(text))
    }
}

/// Equality ignores where a unit was declared.
impl PartialEq for SignalUnit {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text && self.unit == other.unit
    }
}

impl Default for SignalUnit {
    fn default() -> Self {
        Self { text: "1".into(), unit: Unit::ONE, implied: false }
    }
}

impl FromStr for SignalUnit {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        let unit: Unit = text.parse()?;
        if unit.to_si(0.0) != 0.0 {
            return Err(UnitError::Offset { symbol: text.into(), text: "a linear model".into() });
        }
        Ok(Self { text: text.into(), unit, implied: false })
    }
}

impl fmt::Display for SignalUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(text: &str) -> SignalUnit {
        text.parse().unwrap()
    }

    #[test]
    fn units_of_derivatives_and_of_entries_are_written_as_one_writes_them() {
        for (text, derivative) in [
            ("deg", "deg/s"),
            ("deg/s", "deg/s^2"),
            ("m/s^2", "m/s^3"),
            ("1", "1/s"),
            ("%", "%/s"),
            ("rpm", "rpm/s"),
            ("km/h", "km/h/s"),
        ] {
            let found = unit(text).per_second();
            assert_eq!(found.to_string(), derivative);
            assert_eq!(found.to_string().parse(), Ok(*found.unit()), "{text}");
        }
        assert_eq!(unit("deg/s").over(&unit("1")).1.as_deref(), Some("deg/s"));
        assert_eq!(unit("m/s^2").over(&unit("deg")).1.as_deref(), Some("m/s^2/deg"));
        assert_eq!(unit("deg/s^2").over(&unit("m/s")).1, None, "in deg/s^2/m/s the last s would divide too");
    }

    #[test]
    fn a_unit_that_nobody_declared_is_not_taken_for_granted() {
        assert_eq!(unit("rad").two_readings(5.0), None);
        let readings = unit("rad").implied().per_second().two_readings(5.0).unwrap();
        assert!(readings.contains("5 rad/s = 286 deg/s, or 5 deg/s"), "{readings}");
        assert_eq!(unit("m").implied().two_readings(5.0), None);
        assert_eq!(unit("rad").implied(), unit("rad"));
    }
}
