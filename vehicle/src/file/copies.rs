//! Detects rows of a matrix that copy a signal without converting its unit: `C = I` from rad to deg means 1
//! deg per rad.

use whirlstand_msgs::units::number;

use crate::signal_unit::SignalUnit;

/// Name and unit of a signal.
pub(super) type Signal<'a> = (&'a str, &'a SignalUnit);

/// Finds an error in a row of C or D, or of A or B for a derivative: its only entry is 1 or -1 although the
/// two units of one kind differ. Returns the index of the entry, and the correct text.
pub(super) fn unconverted(
    matrix: &str,
    entries: &[f64],
    row: Signal<'_>,
    columns: &[Signal<'_>],
) -> Option<(usize, String)> {
    let mut set = entries.iter().enumerate().filter(|(_, v)| **v != 0.0);
    let (j, &value) = set.next()?;
    if set.next().is_some() || value.abs() != 1.0 {
        return None;
    }
    let (from, from_unit) = columns[j];
    let (to, row_unit) = row;
    let is_derivative = matches!(matrix, "A" | "B");
    let to_unit = if is_derivative { row_unit.per_second() } else { row_unit.clone() };
    let ratio = from_unit.factor() / to_unit.factor();
    // Units such as m/s and km/h*3.6 differ by rounding only.
    if from_unit.dimension() != to_unit.dimension() || (ratio - 1.0).abs() < 1e-9 {
        return None;
    }
    let (right, shown) = (format!("{:?}", value * ratio), number(value * ratio));
    let reason = if is_derivative {
        format!(
            "is {value}, which says that 1 {from_unit} of {from} moves {to} by {value} {to_unit}, not by {shown} {to_unit}: \
             write {right}, or declare {to} so that its derivative is in {from_unit}"
        )
    } else {
        format!(
            "is {value}, which says that 1 {from_unit} of {from} reads as {value} {to_unit} of {to}, not as {shown} {to_unit}: \
             write {right} to copy it, or leave {matrix} out where outputs have the names of states; a sensor that is off by \
             a factor is the effect sensor_scale"
        )
    };
    Some((j, reason))
}
