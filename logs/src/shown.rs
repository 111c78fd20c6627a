//! Values as an engineer reads them: angles in degrees, three or four digits.

pub use whirlstand_msgs::units::{clean, number};

/// The unit in which values with the given SI unit are shown, and how many of it one SI unit is.
fn display(si: &str) -> (String, f64) {
    let degree = 180.0 / std::f64::consts::PI;
    match si.strip_prefix("rad") {
        Some(rest) if rest.is_empty() || rest.starts_with(['/', '*', ' ', '·', '^']) => {
            let power = if rest.starts_with('^') { return (si.into(), 1.0) } else { degree };
            (format!("deg{rest}"), power)
        }
        _ => (si.into(), 1.0),
    }
}

/// Unit in which values with the SI unit `si` are shown.
pub fn shown_unit(si: &str) -> String {
    display(si).0
}

/// So many of something, in the plural where it is not one.
pub fn counted(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

/// How many shown units one SI unit is.
pub fn shown_factor(si: &str) -> f64 {
    display(si).1
}

/// Unit in which a parameter of an effect is shown, and how many of it one SI unit is: in degrees, but for a parameter
/// whose name says radians.
pub fn parameter_unit(name: &str, si: &str) -> (String, f64) {
    if name.ends_with("_rad") { (si.into(), 1.0) } else { display(si) }
}

/// A value with four significant digits and its unit.
pub fn shown(value: f64, si: &str) -> String {
    let (unit, factor) = display(si);
    let number = number(value * factor);
    if unit.is_empty() { number } else { format!("{number} {unit}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_shown_in_degrees() {
        assert_eq!(shown(std::f64::consts::PI, "rad"), "180 deg");
        assert_eq!(shown(0.01, "rad/s"), "0.573 deg/s");
        assert_eq!(shown(-1.234_56, "m"), "-1.23 m");
        assert_eq!(shown(0.0, ""), "0");
        assert_eq!(shown(1234.5, "m/s"), "1234 m/s");
        assert_eq!(shown_unit("radian"), "radian");
        assert_eq!(parameter_unit("angle_rad", "rad"), ("rad".into(), 1.0));
        assert_eq!(parameter_unit("magnitude", "rad/s^2").0, "deg/s^2");
    }
}
