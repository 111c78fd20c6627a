//! Values as an engineer reads them: angles in degrees, three or four digits. What a vehicle file declares is shown by
//! [`ShownUnit`].

pub use whirlstand_msgs::units::{ShownUnit, clean, number};

/// So many of something, in the plural where it is not one.
pub fn counted(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

/// A value of which no file says how it is shown, with four significant digits and its unit.
pub fn shown(value: f64, si: &str) -> String {
    ShownUnit::of(si).text(value)
}
