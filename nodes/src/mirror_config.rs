//! Options of the mirror.

use serde::{Deserialize, Serialize};

/// Options of the mirror.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MirrorConfig {
    /// Reaction to a finding.
    pub on_finding: OnFinding,
}

/// Reaction when the vehicle differs from its file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnFinding {
    /// The finding is only reported.
    #[default]
    Tell,
    /// The controller withholds its commands, so that the plant sets its inputs to neutral, until the
    /// prediction is correct again.
    Failsafe,
    /// The law designed for the cause replaces the one in charge, if it is better in random draws.
    Law,
}
