//! Number formatting for readers.

/// A number with about three significant digits; `-` for one that is not finite.
pub fn number(v: f64) -> String {
    let size = v.abs();
    if v == 0.0 {
        "0".into()
    } else if !v.is_finite() {
        "-".into()
    } else if !(1e-4..1e6).contains(&size) {
        format!("{v:.2e}")
    } else {
        let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{v:.decimals$}")
    }
}

/// A time of a clock in s. How far it is from zero says nothing about how exactly it is known (a clock may count from
/// 1970), so hundredths are kept from 100 s on.
pub fn instant(seconds: f64) -> String {
    if seconds.is_finite() && seconds.abs() >= 100.0 { format!("{seconds:.2}") } else { number(seconds) }
}

/// A number rounded to `digits` significant digits, at least one.
pub fn rounded(v: f64, digits: usize) -> f64 {
    // The text reads back as the nearest number, which prints with the fewest digits that identify it.
    format!("{v:.*e}", digits.max(1) - 1).parse().unwrap_or(v)
}

/// Significant digits of a number free of arithmetic noise: 120 for 120.00000000000001.
pub const MEANT_DIGITS: usize = 12;

/// A number without the noise of floating-point arithmetic: [`MEANT_DIGITS`], without trailing zeros.
pub fn clean(v: f64) -> String {
    let rounded = rounded(v, MEANT_DIGITS);
    if rounded == 0.0 || (1e-5..1e15).contains(&rounded.abs()) || !rounded.is_finite() {
        format!("{rounded}")
    } else {
        format!("{rounded:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_arithmetic_adds_is_not_shown() {
        for (value, text) in [
            (120.000_000_000_000_01, "120"),
            (0.010_000_000_000_000_009, "0.01"),
            (0.1 + 0.2, "0.3"),
            (0.0, "0"),
            (-1.0 / 3.0, "-0.333333333333"),
            (2.5e-7, "2.5e-7"),
            (1e6, "1000000"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(clean(value), text);
        }
        assert_eq!(number(2.5e-7), "2.50e-7");
        assert_eq!(number(1234.5), "1234");
        assert_eq!(instant(1_690_000_012.346), "1690000012.35");
        assert_eq!(instant(12.346), "12.3");
        assert_eq!(instant(f64::NAN), "-");
    }
}
