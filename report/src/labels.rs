//! Labels of rows and axes: names with units.

/// A name with its unit, such as "roll, deg"; the name alone where it has none.
pub fn with_unit(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.into() } else { format!("{name}, {unit}") }
}

/// The square of a unit; empty where there is none.
pub fn squared(unit: &str) -> String {
    match unit {
        "" => String::new(),
        u if u.contains('/') => format!("({u})²"),
        u => format!("{u}²"),
    }
}

/// The unit of a power spectral density, such as "deg² / Hz".
pub fn density(unit: &str) -> String {
    match unit {
        "" => "1 / Hz".into(),
        u => format!("{} / Hz", squared(u)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_unit_has_none_in_its_label() {
        assert_eq!((with_unit("roll", "deg"), with_unit("x1", "")), ("roll, deg".into(), "x1".into()));
        assert_eq!((density("deg/s"), density("")), ("(deg/s)² / Hz".into(), "1 / Hz".into()));
    }
}
