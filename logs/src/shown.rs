//! Values in the form that engineers read: angles in degrees, three or four digits. Values with a unit declared in
//! a vehicle file are shown by [`ShownUnit`].

pub use whirlstand_msgs::units::{ShownUnit, clean, instant, number};

/// A count and its noun, in the plural unless the count is 1.
pub fn counted(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

/// A value for which no file declares a unit, with four significant digits and its unit.
pub fn shown(value: f64, si: &str) -> String {
    ShownUnit::of(si).text(value)
}
