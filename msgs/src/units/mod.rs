//! Units: in brackets in a column head, after a number in a launch file, beside a signal in a vehicle file.
//! Every value is converted to SI where it is read; angles are in rad.
//!
//! A unit is a product of symbols with whole exponents: `deg/s`, `m/s^2`, `kg*m^2`, `N m`, `V`, `1/s`, `%`.
//! Everything after a slash divides: `m/s/s` and `m/s*s` are both `m/s^2`. Symbols of SI take the prefixes n, u
//! (or µ), m, c, h, k and M: `ms`, `mrad`, `kHz`. `g` is standard gravity, as in an accelerometer's data sheet,
//! not gram. No unit, `1` and `-` mean dimensionless.
//!
//! ```
//! use whirlstand_msgs::units::{Quantity, Unit};
//!
//! let rate: Unit = "deg/s".parse().unwrap();
//! assert_eq!(rate.si_symbol(), "rad/s");
//! assert!((rate.to_si(180.0) - std::f64::consts::PI).abs() < 1e-15);
//! let tilt: Quantity = "5 deg".parse().unwrap();
//! assert!((tilt.in_unit(&"rad".parse().unwrap()).unwrap() - 5f64.to_radians()).abs() < 1e-15);
//! ```

mod bare;
mod dimension;
mod number;
mod shown;
mod shown_signals;
mod symbols;
mod unit;

use std::str::FromStr;

pub use self::bare::two_readings;
pub use self::dimension::Dimension;
pub use self::number::{MEANT_DIGITS, clean, instant, number, rounded};
pub use self::shown::ShownUnit;
pub use self::shown_signals::ShownSignals;
use self::symbols::lookup;
pub use self::unit::Unit;

/// Reason why a text is not a unit or a quantity.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UnitError {
    /// A symbol is not in the table.
    #[error(
        "'{symbol}' in '{text}' is not a known unit; known are for example deg, rad, deg/s, m/s, m/s^2, g, V, N, Hz, rpm, s, ms, samples, %"
    )]
    Unknown {
        /// Unknown symbol.
        symbol: String,
        /// The whole text.
        text: String,
    },
    /// An exponent is not a small integer.
    #[error("'{exponent}' in '{text}' is not an exponent: write a whole number from -9 to 9, as in m/s^2")]
    Exponent {
        /// Text after the caret.
        exponent: String,
        /// The whole text.
        text: String,
    },
    /// A unit with its own zero point is part of a product.
    #[error("'{symbol}' has its own zero point and cannot be part of '{text}': use K instead")]
    Offset {
        /// Symbol of the unit.
        symbol: String,
        /// The whole text.
        text: String,
    },
    /// A quantity does not begin with a finite number.
    #[error("'{text}' is not a quantity: write a number and a unit, as in \"5 deg\"")]
    Number {
        /// The whole text.
        text: String,
    },
    /// A unit has another dimension than expected.
    #[error("'{text}' is in {found}, but a quantity in {expected} is expected here")]
    Dimension {
        /// The whole text.
        text: String,
        /// Dimension of the unit, as an SI unit.
        found: String,
        /// The expected dimension, as an SI unit.
        expected: String,
    },
}

impl FromStr for Unit {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        let trimmed = text.trim();
        if let Some(whole) = lookup(trimmed) {
            return Ok(whole);
        }
        let mut unit = Self::ONE;
        let mut rest = trimmed;
        let mut over = true;
        loop {
            let end = rest.find(['/', '*', '.', '·']).unwrap_or(rest.len());
            // A space between two symbols is a product sign too, as SI writes it: N m.
            let mut factors = rest[..end].split_whitespace();
            unit = unit.multiplied(factors.next().unwrap_or_default(), over, trimmed)?;
            for factor in factors {
                unit = unit.multiplied(factor, over, trimmed)?;
            }
            let mut tail = rest[end..].chars();
            match tail.next() {
                None => return Ok(unit),
                Some('/') => over = false,
                // A product sign stays on its side: in kg*m/s*s the last s is below the slash, as most people
                // write it.
                Some(_) => {}
            }
            rest = tail.as_str();
        }
    }
}

impl Unit {
    fn multiplied(self, factor: &str, over: bool, text: &str) -> Result<Self, UnitError> {
        let (name, exponent) = split_exponent(factor);
        let wrong = || UnitError::Exponent { exponent: exponent.unwrap_or("").into(), text: text.into() };
        let power = match exponent {
            None => 1,
            Some(digits) => digits.parse::<i8>().ok().filter(|p| (-9..=9).contains(p)).ok_or_else(wrong)?,
        };
        let power = if over { power } else { -power };
        let symbol = match name {
            "" => None,
            name => lookup(name),
        }
        .ok_or_else(|| UnitError::Unknown { symbol: name.into(), text: text.into() })?;
        if symbol.offset != 0.0 {
            return Err(UnitError::Offset { symbol: name.into(), text: text.into() });
        }
        let dimension = self.dimension.times(symbol.dimension, power).ok_or_else(wrong)?;
        Ok(Self { factor: self.factor * symbol.factor.powi(power.into()), offset: 0.0, dimension })
    }
}

/// `m^2`, `m2` and `m²` are `m` with exponent 2.
fn split_exponent(factor: &str) -> (&str, Option<&str>) {
    if let Some((name, exponent)) = factor.split_once('^').or_else(|| factor.split_once("**")) {
        return (name.trim(), Some(exponent.trim()));
    }
    for (sign, digits) in [("²", "2"), ("³", "3")] {
        if let Some(name) = factor.strip_suffix(sign) {
            return (name, Some(digits));
        }
    }
    let name = factor.trim_end_matches(|c: char| c.is_ascii_digit() || c == '-');
    if name.is_empty() || name.len() == factor.len() {
        (factor, None)
    } else {
        (name, Some(&factor[name.len()..]))
    }
}

/// A number with its unit, for example `5 deg`.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// Value in the coherent SI unit of `unit`.
    pub si: f64,
    /// Unit in which the quantity was written.
    pub unit: Unit,
    text: String,
}

impl Quantity {
    /// The value in `unit`.
    ///
    /// # Errors
    /// [`UnitError::Dimension`] when the two measure different things.
    pub fn in_unit(&self, unit: &Unit) -> Result<f64, UnitError> {
        if self.unit.dimension == unit.dimension {
            return Ok(unit.from_si(self.si));
        }
        let name = |d: Dimension| if d.is_none() { "no unit".to_string() } else { d.to_string() };
        Err(UnitError::Dimension {
            text: self.text.clone(),
            found: name(self.unit.dimension),
            expected: name(unit.dimension),
        })
    }
}

impl FromStr for Quantity {
    type Err = UnitError;

    fn from_str(text: &str) -> Result<Self, UnitError> {
        let trimmed = text.trim();
        // The longest prefix that is a number: 'e' may belong to it (1e3 m) or not (5 e...), so try from the end.
        let ends = trimmed.char_indices().map(|(i, _)| i).chain([trimmed.len()]).rev();
        let (value, end) = ends
            .filter_map(|end| Some((trimmed[..end].trim_end().parse::<f64>().ok()?, end)))
            .find(|(value, _)| value.is_finite())
            .ok_or_else(|| UnitError::Number { text: trimmed.into() })?;
        let unit: Unit = trimmed[end..].parse()?;
        Ok(Self { si: unit.to_si(value), unit, text: trimmed.into() })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::symbols::SYMBOLS;
    use super::*;
    use proptest::prelude::*;

    fn si(text: &str) -> (f64, String) {
        let unit: Unit = text.parse().unwrap_or_else(|e| panic!("{e}"));
        (unit.to_si(1.0), unit.si_symbol())
    }

    #[test]
    fn units_of_flight_records_reach_si() {
        let cases: &[(&str, f64, &str)] = &[
            ("", 1.0, ""),
            ("1", 1.0, ""),
            ("-", 1.0, ""),
            ("%", 0.01, ""),
            ("deg", PI / 180.0, "rad"),
            ("deg/s", PI / 180.0, "rad/s"),
            ("deg/s^2", PI / 180.0, "rad/s^2"),
            ("rad/s", 1.0, "rad/s"),
            ("mrad", 1e-3, "rad"),
            ("rpm", PI / 30.0, "rad/s"),
            ("g", 9.80665, "m/s^2"),
            ("m/s", 1.0, "m/s"),
            ("m/s/s", 1.0, "m/s^2"),
            ("m/s2", 1.0, "m/s^2"),
            ("m s^-2", 1.0, "m/s^2"),
            ("m*s^-2", 1.0, "m/s^2"),
            ("cm/s", 0.01, "m/s"),
            ("kt", 1852.0 / 3600.0, "m/s"),
            ("V", 1.0, "V"),
            ("mV", 1e-3, "V"),
            ("N", 1.0, "N"),
            ("N.m", 1.0, "N*m"),
            ("N m", 1.0, "N*m"),
            ("N m / s", 1.0, "W"),
            ("N*m", 1.0, "N*m"),
            ("kg*m^2", 1.0, "kg*m^2"),
            ("samples", 1.0, "samples"),
            ("ms", 1e-3, "s"),
            ("us", 1e-6, "s"),
            ("µs", 1e-6, "s"),
            ("min", 60.0, "s"),
            ("kHz", 1e3, "1/s"),
            ("1/s", 1.0, "1/s"),
            ("deg C", f64::NAN, ""),
            ("hPa", 100.0, "Pa"),
            ("gauss", 1e-4, "T"),
            ("degC", 274.15, "K"),
        ];
        for (text, factor, symbol) in cases {
            if factor.is_nan() {
                assert!(text.parse::<Unit>().is_err(), "{text}");
                continue;
            }
            let (found, si_symbol) = si(text);
            assert!((found - factor).abs() <= 4.0 * f64::EPSILON * factor, "{text}: {found}");
            assert_eq!(si_symbol, *symbol, "{text}");
        }
    }

    #[test]
    fn errors_say_which_symbol_is_wrong() {
        let error = "furlong/s".parse::<Unit>().unwrap_err();
        assert!(matches!(&error, UnitError::Unknown { symbol, .. } if symbol == "furlong"), "{error}");
        assert!(matches!("m^x".parse::<Unit>(), Err(UnitError::Exponent { .. })));
        assert!(matches!("degC/s".parse::<Unit>(), Err(UnitError::Offset { .. })));
        assert!(matches!("m/".parse::<Unit>(), Err(UnitError::Unknown { .. })));
    }

    #[test]
    fn quantities_carry_their_dimension() {
        let rad: Unit = "rad".parse().unwrap();
        let tilt: Quantity = "5 deg".parse().unwrap();
        assert_eq!(tilt.in_unit(&rad).unwrap(), 5.0 * (PI / 180.0));
        assert_eq!("-3.5e-2m/s".parse::<Quantity>().unwrap().si, -0.035);
        assert_eq!("12".parse::<Quantity>().unwrap().in_unit(&Unit::ONE).unwrap(), 12.0);
        let error = "5 m".parse::<Quantity>().unwrap().in_unit(&rad).unwrap_err();
        assert_eq!(error.to_string(), "'5 m' is in m, but a quantity in rad is expected here");
        assert!(matches!("deg 5".parse::<Quantity>(), Err(UnitError::Number { .. })));
        assert!(matches!("inf m".parse::<Quantity>(), Err(UnitError::Number { .. })));
    }

    proptest! {
        #[test]
        fn an_si_symbol_reads_back_as_the_same_dimension(powers in prop::array::uniform7(-3i8..4)) {
            let dimension = Dimension(powers);
            let unit: Unit = dimension.to_string().parse().unwrap();
            prop_assert_eq!(unit.dimension(), dimension);
            prop_assert!(unit.is_si());
        }

        #[test]
        fn from_si_undoes_to_si(value in -1e6f64..1e6, index in 0usize..SYMBOLS.len()) {
            let unit: Unit = SYMBOLS[index].names[0].parse().unwrap();
            let back = unit.from_si(unit.to_si(value));
            prop_assert!((back - value).abs() <= 1e-9 * (1.0 + value.abs()), "{} {}", value, back);
        }

        #[test]
        fn any_text_is_a_unit_or_an_error(text in "\\PC{0,12}") {
            let _ = text.parse::<Unit>();
            let _ = text.parse::<Quantity>();
        }
    }
}
