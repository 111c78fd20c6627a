//! Numbers that mark missing values in tables, such as -999.

use std::fmt;

/// Numbers that programs write where they have no value: those of meteorological and geophysical tables, netCDF's fill
/// values (NetCDF User's Guide, appendix B), the ends of integer types (MAVLink: the greatest value of a field means that it
/// is not known), and the greatest numbers of floating-point types.
const MARKS: [f64; 22] = [
    -999.0,
    -9999.0,
    -99999.0,
    -999.99,
    -999.9,
    999.0,
    9999.0,
    99999.0,
    1e20,
    1e30,
    -1e30,
    1e36,
    9.96921e36,
    32767.0,
    -32768.0,
    65535.0,
    2_147_483_647.0,
    -2_147_483_648.0,
    4_294_967_295.0,
    f32::MAX as f64,
    f32::MIN as f64,
    f64::MAX,
];

/// A number that a column holds in place of missing values.
#[derive(Debug, Clone, PartialEq)]
pub struct MissingMark {
    /// The signal.
    pub name: String,
    /// The number, as the file has it.
    pub mark: f64,
    /// How many cells hold it.
    pub cells: usize,
}

impl fmt::Display for MissingMark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, mark, cells } = self;
        let shown = if mark.abs() < 1e10 { format!("{mark}") } else { format!("{mark:e}") };
        write!(f, "{name}: {cells} values of {shown} stand for missing ones and are not used")
    }
}

/// Replaces marks by NaN. A number of the list is a mark where it is as far from all other values of the column as these are
/// from each other: a saturated signal comes near its limit before it reaches it. `convert` turns a number of the file
/// into one of the column.
pub(crate) fn take_out(values: &mut [f64], convert: impl Fn(f64) -> f64) -> Option<(f64, usize)> {
    let found = MARKS.iter().find_map(|mark| {
        let of_column = convert(*mark);
        let is_mark = |v: f64| v == of_column;
        values.iter().any(|v| is_mark(*v)).then_some(())?;
        let others = values.iter().copied().filter(|v| v.is_finite() && !is_mark(*v));
        let (low, high) = others.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let apart = (low - of_column).max(of_column - high);
        // Where all others are equal, the column may be one of two commands.
        (high > low && apart > high - low).then_some((*mark, of_column))
    });
    let (mark, of_column) = found?;
    let mut cells = 0;
    for value in values.iter_mut().filter(|v| **v == of_column) {
        *value = f64::NAN;
        cells += 1;
    }
    Some((mark, cells))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_become_missing_values_and_limits_do_not() {
        let degrees = |v: f64| v.to_radians();
        let mut values = [1.0, 2.0, -999.0, 3.5, -999.0].map(degrees);
        assert_eq!(take_out(&mut values, degrees), Some((-999.0, 2)));
        assert!(values[2].is_nan() && values[4].is_nan() && values[0] == degrees(1.0));
        let same = |v: f64| v;
        let mut saturated = [0.0, 15_000.0, 32_767.0, 32_767.0, -20_000.0];
        assert_eq!(take_out(&mut saturated, same), None);
        let mut two_commands = [0.0, 65_535.0, 0.0, 65_535.0];
        assert_eq!(take_out(&mut two_commands, same), None);
        assert_eq!(take_out(&mut [0.1, 0.2, 0.3], same), None);
    }
}
