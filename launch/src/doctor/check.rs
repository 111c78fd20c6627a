//! One check of the machine, and its result.

use serde::Serialize;

/// Result of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Grade {
    /// Fit.
    Ok,
    /// Works, but timing suffers, or an option of the launch file will be refused.
    Warn,
    /// Cannot be found out here.
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
    /// What to change; nothing when all is well.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<String>,
}
