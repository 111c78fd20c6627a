//! Values of an effect's keys, as written in files.

/// The value of a key, as written in a file.
#[derive(Debug, Clone, PartialEq, serde::Deserialize)]
#[serde(untagged)]
pub enum FieldValue {
    /// A number, in SI.
    Number(f64),
    /// A text: a quantity such as `"5 deg"`, or the value of a text parameter.
    Text(String),
}
