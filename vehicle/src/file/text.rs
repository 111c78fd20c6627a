//! Text fragments of a vehicle file.

use std::fmt::Write as _;

/// Appends a line.
pub fn push(text: &mut String, line: &str) {
    text.push_str(line);
    text.push('\n');
}

/// The shortest number that, times the factor, reads back as `si`; else all digits of the quotient.
pub fn number(si: f64, factor: f64) -> String {
    let exact = si / factor;
    let mut text = String::with_capacity(24);
    for digits in 0..17 {
        text.clear();
        // Writing to a String is infallible.
        let _ = write!(text, "{exact:.digits$e}");
        if let Ok(short) = text.parse::<f64>()
            && short * factor == si
        {
            return format!("{short:?}");
        }
    }
    format!("{exact:?}")
}

/// A text in quotation marks, with TOML escapes.
pub fn quoted(text: &str) -> String {
    toml::Value::String(text.into()).to_string()
}
