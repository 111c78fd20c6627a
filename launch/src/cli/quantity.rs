//! Times and frequencies on the command line: a number in SI, or one with its unit, the same for every option.

use whirlstand_msgs::units::{Quantity, Unit};

/// A time that something takes, s.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value = moment(text)?;
    if value > 0.0 {
        Ok(value)
    } else {
        Err(format!(
            "'{text}' is not a positive time: write seconds, or a number with a unit as in \"2 min\""
        ))
    }
}

/// A time on some clock, s.
pub(super) fn moment(text: &str) -> Result<f64, String> {
    let value = si(text, &Unit::SECOND)?;
    if value.is_finite() {
        Ok(value)
    } else {
        Err(format!("'{text}' is not a time: write seconds, or a number with a unit as in \"2 min\""))
    }
}

/// A rate or a frequency, Hz.
pub(super) fn hertz(text: &str) -> Result<f64, String> {
    // The table of units knows it.
    let unit = "Hz".parse().unwrap_or(Unit::ONE);
    let value = si(text, &unit)?;
    if value.is_finite() && value > 0.0 {
        Ok(value)
    } else {
        Err(format!(
            "'{text}' is not a positive frequency: write Hz, or a number with a unit as in \"1 kHz\""
        ))
    }
}

/// `FROM:TO`, a part of a record by its clock, s.
pub(super) fn interval(text: &str) -> Result<(f64, f64), String> {
    let expected =
        || format!("'{text}' is not a part of a record: write FROM:TO, as in 60:84 or \"1 min:84 s\"");
    let (from, to) = text.split_once(':').ok_or_else(expected)?;
    let (from, to) = (moment(from)?, moment(to)?);
    if from < to { Ok((from, to)) } else { Err(expected()) }
}

fn si(text: &str, unit: &Unit) -> Result<f64, String> {
    if let Ok(value) = text.trim().parse::<f64>() {
        return Ok(value);
    }
    let quantity: Quantity = text.parse().map_err(|e| format!("{e}"))?;
    quantity.in_unit(unit).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_seconds_or_carry_a_unit_of_time() {
        assert_eq!(seconds("12"), Ok(12.0));
        assert_eq!(seconds("2 min"), Ok(120.0));
        assert!(seconds("5 m").unwrap_err().contains("s is expected"), "{:?}", seconds("5 m"));
        assert!(seconds("-1").is_err() && seconds("nan").is_err() && seconds("soon").is_err());
        assert_eq!((moment("-500 ms"), moment("0")), (Ok(-0.5), Ok(0.0)));
    }

    #[test]
    fn frequencies_are_hertz_or_carry_a_unit_of_frequency() {
        assert_eq!((hertz("100"), hertz("1 kHz"), hertz("0.2Hz")), (Ok(100.0), Ok(1000.0), Ok(0.2)));
        for wrong in ["2 s", "5 rad/s", "0", "-3 Hz", "inf"] {
            assert!(hertz(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn parts_of_records_carry_units_at_both_ends() {
        assert_eq!(interval("60:84"), Ok((60.0, 84.0)));
        assert_eq!(interval("1 min:1.5min"), Ok((60.0, 90.0)));
        for wrong in ["60", "84:60", "1 m:2 m"] {
            assert!(interval(wrong).is_err(), "{wrong}");
        }
    }
}
