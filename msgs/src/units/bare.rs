//! A number without a unit where the declared unit is not SI is ambiguous: both readings are reported, and
//! neither is assumed.

use super::{Unit, number};

/// Reason why a number without a unit is ambiguous for a quantity declared in `unit`, whose text is `symbol`
/// where it has one: both readings side by side, and what to write. `None` where the readings agree: the unit
/// is SI, or the number is zero.
pub fn two_readings(value: f64, unit: &Unit, symbol: Option<&str>) -> Option<String> {
    if value == 0.0 || unit.is_si() {
        return None;
    }
    let si = unit.si_symbol();
    let in_si = |value: String| if si.is_empty() { value } else { format!("{value} {si}") };
    let (readings, example) = match symbol {
        Some(symbol) => {
            let declared = format!("{value} {symbol}");
            let converted = number(unit.from_si(value));
            (format!("{} = {converted} {symbol}, or {declared}", in_si(value.to_string())), declared)
        }
        None => {
            let declared = in_si(number(unit.to_si(value)));
            let direct = in_si(value.to_string());
            (format!("{direct}, or {declared} by the units that the file declares"), declared)
        }
    };
    Some(format!("is {value} without a unit: {readings}: write the unit, as in \"{example}\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_readings_stand_side_by_side() {
        let readings = |value, symbol: &str| two_readings(value, &symbol.parse().unwrap(), Some(symbol));
        assert_eq!(
            readings(5.0, "deg").unwrap(),
            "is 5 without a unit: 5 rad = 286 deg, or 5 deg: write the unit, as in \"5 deg\""
        );
        assert!(readings(60.0, "deg/s^2").unwrap().contains("60 rad/s^2 = 3438 deg/s^2, or 60 deg/s^2"));
        assert!(readings(50.0, "%").unwrap().contains("50 = 5000 %, or 50 %"));
        for (value, symbol) in [(0.0, "deg"), (5.0, "rad"), (5.0, "m/s"), (5.0, "1"), (5.0, "V")] {
            assert_eq!(readings(value, symbol), None, "{value} {symbol}");
        }
        let unit: Unit = "m/s^2/deg".parse().unwrap();
        let text = two_readings(0.36, &unit, None).unwrap();
        assert!(text.contains("0.36 m/rad/s^2, or 20.6 m/rad/s^2 by the units"), "{text}");
    }
}
