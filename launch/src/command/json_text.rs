//! JSON as it is printed and written: indented, with numbers rounded to remove floating-point noise.

use std::io::{Result, Write};

use serde::Serialize;
use serde_json::ser::{Formatter, PrettyFormatter, Serializer};
use whirlstand_msgs::units::{MEANT_DIGITS, rounded};

/// A value as indented JSON, its numbers with twelve significant digits.
///
/// # Errors
/// When the value cannot be JSON, such as a map whose keys are not strings.
pub(super) fn pretty(value: &impl Serialize) -> serde_json::Result<String> {
    let mut text = Vec::new();
    value.serialize(&mut Serializer::with_formatter(&mut text, Clean(PrettyFormatter::new())))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// A formatter that rounds numbers and leaves indentation to the formatter inside.
struct Clean<'a>(PrettyFormatter<'a>);

impl Formatter for Clean<'_> {
    fn write_f64<W: ?Sized + Write>(&mut self, writer: &mut W, value: f64) -> Result<()> {
        self.0.write_f64(writer, rounded(value, MEANT_DIGITS))
    }

    fn begin_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.begin_array(writer)
    }

    fn end_array<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.end_array(writer)
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> Result<()> {
        self.0.begin_array_value(writer, first)
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.end_array_value(writer)
    }

    fn begin_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.begin_object(writer)
    }

    fn end_object<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.end_object(writer)
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, writer: &mut W, first: bool) -> Result<()> {
        self.0.begin_object_key(writer, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.begin_object_value(writer)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, writer: &mut W) -> Result<()> {
        self.0.end_object_value(writer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_that_were_meant_and_nothing_else_changes() {
        let value = serde_json::json!({
            "a": [120.000_000_000_000_01, 0.1 + 0.2, 1e-300, -0.0, 7, u64::MAX],
            "b": { "none": null, "empty": [], "text": "1.00000000000000002" },
        });
        let text = pretty(&value).unwrap();
        let usual = serde_json::to_string_pretty(&value).unwrap();
        assert_eq!(text, usual.replace("120.00000000000001", "120.0").replace("0.30000000000000004", "0.3"));
    }
}
