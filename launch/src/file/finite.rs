//! Numbers of a launch file that are infinite or not a number.

use std::ops::Range;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Position of the first number that is infinite or NaN. Neither has a meaning in a launch file, and JSON, in
/// which a node receives its configuration, cannot represent them.
pub(super) fn not_finite(table: &DeTable<'_>) -> Option<Range<usize>> {
    table.iter().find_map(|(_, value)| of_value(value))
}

fn of_value(value: &Spanned<DeValue<'_>>) -> Option<Range<usize>> {
    match value.get_ref() {
        DeValue::Float(number) => {
            let is_finite = number.as_str().parse::<f64>().map_or(true, f64::is_finite);
            (!is_finite).then(|| value.span())
        }
        DeValue::Array(values) => values.iter().find_map(of_value),
        DeValue::Table(table) => not_finite(table),
        _ => None,
    }
}
