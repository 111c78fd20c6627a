//! Units in which SI values are shown to a reader.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Unit, number};

/// Unit in which SI values are shown: that which the vehicle file declares for the signal, or, where no file
/// declares one, SI with angles in degrees. It is serialised as the SI unit, like the values beside it.
///
/// ```
/// use whirlstand_msgs::units::ShownUnit;
///
/// assert_eq!(ShownUnit::of("rad/s").text(0.01), "0.573 deg/s");
/// assert_eq!(ShownUnit::declared(&"rad/s".parse().unwrap(), "rad/s").text(0.01), "0.0100 rad/s");
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct ShownUnit {
    si: String,
    symbol: String,
    /// Number of shown units per SI unit.
    factor: f64,
}

impl ShownUnit {
    /// Unit for values in this SI unit without a declaration: degrees for angles, SI for all else.
    pub fn of(si: &str) -> Self {
        let degrees =
            si.strip_prefix("rad").filter(|rest| rest.is_empty() || rest.starts_with(['/', '*', ' ', '·']));
        match degrees {
            Some(rest) => Self { si: si.into(), symbol: format!("deg{rest}"), factor: 1f64.to_degrees() },
            None => Self::si(si),
        }
    }

    /// Shown unit equal to SI.
    pub fn si(si: &str) -> Self {
        Self { si: si.into(), symbol: si.into(), factor: 1.0 }
    }

    /// Shown unit as a file declares it, with its text.
    pub fn declared(unit: &Unit, symbol: &str) -> Self {
        let symbol = if *unit == Unit::ONE { "" } else { symbol.trim() };
        Self { si: unit.si_symbol(), symbol: symbol.into(), factor: 1.0 / unit.factor() }
    }

    /// Shown unit from a [symbol](Self::symbol) shown before; for an unknown symbol, that of [`Self::of`] for
    /// `si`.
    pub fn named(si: &str, symbol: &str) -> Self {
        symbol.parse().map_or_else(|_| Self::of(si), |unit| Self::declared(&unit, symbol))
    }

    /// Symbol of the SI unit in which the values are held; empty for a dimensionless number.
    pub fn si_symbol(&self) -> &str {
        &self.si
    }

    /// Symbol that is shown; empty for a dimensionless number.
    pub fn symbol(&self) -> &str {
        &self.symbol
    }

    /// Number of shown units per SI unit.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// A value in SI with three or four significant digits and its unit.
    pub fn text(&self, si: f64) -> String {
        let number = number(si * self.factor);
        if self.symbol.is_empty() { number } else { format!("{number} {}", self.symbol) }
    }

    /// Unit of the derivative of a quantity with this unit.
    pub fn per_second(&self) -> Self {
        Self { si: per_second(&self.si), symbol: per_second(&self.symbol), factor: self.factor }
    }

    /// Unit of a factor from the other unit to this one; SI where no symbol can be written for it, as units
    /// have no brackets.
    pub fn over(&self, other: &Self) -> Self {
        if other.symbol.is_empty() && other.si.is_empty() {
            return self.clone();
        }
        let quotient = |a: &str, b: &str| a.parse::<Unit>().ok()?.times(&b.parse().ok()?, -1);
        let (Some(si), Some(unit)) = (quotient(&self.si, &other.si), quotient(&self.symbol, &other.symbol))
        else {
            return Self::si("");
        };
        let symbol = match self.symbol.as_str() {
            "" => format!("1/{}", other.symbol),
            symbol => format!("{symbol}/{}", other.symbol),
        };
        let reads_back = symbol.parse::<Unit>().is_ok_and(|read| {
            read.dimension() == unit.dimension() && (read.factor() / unit.factor() - 1.0).abs() < 1e-12
        });
        // A unit that is SI anyway is written in the shorter way: 1/s^2, not rad/s^2/rad, but rad/s^2/V.
        let si = si.si_symbol();
        if reads_back && !(unit.is_si() && si.len() <= symbol.len()) {
            Self::declared(&unit, &symbol)
        } else {
            Self::si(&si)
        }
    }

    /// Unit of the root of a spectral density of a quantity with this unit.
    pub fn per_root_hertz(&self) -> Self {
        let root = |unit: &str| if unit.is_empty() { "1/√Hz".into() } else { format!("{unit}/√Hz") };
        Self { si: root(&self.si), symbol: root(&self.symbol), factor: self.factor }
    }
}

impl Default for ShownUnit {
    fn default() -> Self {
        Self::si("")
    }
}

impl From<String> for ShownUnit {
    fn from(si: String) -> Self {
        Self::of(&si)
    }
}

impl From<ShownUnit> for String {
    fn from(unit: ShownUnit) -> Self {
        unit.si
    }
}

impl fmt::Display for ShownUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.symbol)
    }
}

/// Symbol of the derivative of a quantity with this unit.
fn per_second(unit: &str) -> String {
    let power = unit.rsplit_once("/s^").and_then(|(head, power)| Some((head, power.parse::<u8>().ok()?)));
    match (unit, power) {
        ("", _) => "1/s".into(),
        (_, Some((head, power))) => format!("{head}/s^{}", power.saturating_add(1)),
        _ if unit.ends_with("/s") => format!("{unit}^2"),
        _ => format!("{unit}/s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn declared(text: &str) -> ShownUnit {
        ShownUnit::declared(&text.parse().unwrap(), text)
    }

    #[test]
    fn angles_that_nobody_declared_are_shown_in_degrees() {
        assert_eq!(ShownUnit::of("rad").text(std::f64::consts::PI), "180 deg");
        assert_eq!(ShownUnit::of("rad/s").text(0.01), "0.573 deg/s");
        assert_eq!(ShownUnit::of("m").text(-1.234_56), "-1.23 m");
        assert_eq!(ShownUnit::of("").text(0.0), "0");
        assert_eq!(ShownUnit::of("m/s").text(1234.5), "1234 m/s");
        assert_eq!(ShownUnit::of("radian").symbol(), "radian");
        assert_eq!(ShownUnit::of("rad^2*s").symbol(), "rad^2*s");
    }

    #[test]
    fn a_shown_unit_is_found_again_by_its_symbol() {
        let shown = ["mrad", "%", "1", "km/h"].map(declared);
        let of = ["rad*s", "rad^2*s", "rad/s^2", "m", ""].map(ShownUnit::of);
        for unit in shown.iter().chain(&of) {
            assert_eq!(ShownUnit::named(unit.si_symbol(), unit.symbol()).text(0.5), unit.text(0.5), "{unit}");
        }
        assert_eq!(ShownUnit::named("rad", "no unit"), ShownUnit::of("rad"));
    }

    #[test]
    fn what_a_file_declares_is_shown_as_it_stands_there() {
        for (text, si, value, shown) in [
            ("rad", "rad", 0.5, "0.500 rad"),
            ("mrad", "rad", 0.5, "500 mrad"),
            ("deg", "rad", 0.5, "28.6 deg"),
            ("%", "", 0.5, "50.0 %"),
            ("km/h", "m/s", 10.0, "36.0 km/h"),
            ("1", "", 0.5, "0.500"),
        ] {
            let unit = declared(text);
            assert_eq!((unit.si_symbol(), unit.text(value).as_str()), (si, shown), "{text}");
        }
    }

    #[test]
    fn a_derivative_is_shown_in_the_signals_own_unit() {
        assert_eq!(declared("rad/s").per_second().text(1.0), "1.00 rad/s^2");
        assert_eq!(ShownUnit::of("rad/s").per_second().text(1.0), "57.3 deg/s^2");
        assert_eq!(declared("m/s^2").per_second().symbol(), "m/s^3");
        assert_eq!(declared("1").per_second().symbol(), "1/s");
    }

    #[test]
    fn it_is_written_as_the_unit_of_the_values_beside_it() {
        assert_eq!(serde_json::to_string(&declared("mrad")).unwrap(), "\"rad\"");
        assert_eq!(serde_json::from_str::<ShownUnit>("\"rad\"").unwrap(), ShownUnit::of("rad"));
    }
}
