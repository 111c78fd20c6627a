//! Options of the mirror.

use serde::{Deserialize, Serialize};

/// Options of the mirror.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MirrorConfig {
    /// What is done about a finding.
    pub on_finding: OnFinding,
}

/// What is done when the vehicle is no longer the one in the file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnFinding {
    /// It is said.
    #[default]
    Tell,
    /// The controller withholds its commands, so that the plant brings its inputs to neutral, until prediction is right again.
    Failsafe,
    /// The law that is designed for the cause takes the place of the one that flies, once it is the better one on draws.
    Law,
}
