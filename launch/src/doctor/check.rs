//! One check of the machine, and its result.

use serde::Serialize;

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Grade {
    /// The machine is fit in this respect.
    Ok,
    /// It works, but timing suffers, or an option of the launch file will be refused.
    Warn,
    /// This cannot be determined here.
    Unknown,
}

/// One check of the machine.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Check {
    /// Short name.
    pub name: &'static str,
    /// Result of the check.
    pub grade: Grade,
    /// What was found.
    pub found: String,
    /// What to change; `None` when nothing needs to change.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}
