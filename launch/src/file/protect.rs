//! The protection that a launch file requests.

use std::path::Path;

use whirlstand_bus::{Transport, ZenohConfig};

use super::document::{LaunchError, at};
use super::plan::Planner;
use super::schema::{LaunchFile, SecurityMode};
use super::security::{Security, secret_beyond_its_reach};
use crate::key_folder::KeyFolder;

impl Planner<'_> {
    /// The protection that the launch file states, or else a secret. A bench that a secret cannot protect has to
    /// state its protection.
    pub(super) fn security(
        &self,
        file: &LaunchFile,
        zenoh: &ZenohConfig,
        folder: &Path,
    ) -> Result<Security, LaunchError> {
        let section = &file.security;
        let wrong = |key: &str, message: &str| Err(self.document.error_at(at!["security", key], message));
        let keys = match (section.mode, &section.keys) {
            (Some(SecurityMode::Tls), None) => {
                return wrong(
                    "mode",
                    "mode = \"tls\" needs keys = \"FOLDER\": make one with `whirlstand keys new`",
                );
            }
            (Some(SecurityMode::Tls), Some(keys)) => Some(KeyFolder(folder.join(keys))),
            (_, Some(_)) => {
                return wrong("keys", "keys are used with mode = \"tls\" only: add it, or leave them out");
            }
            (_, None) => None,
        };
        if file.transport != Transport::Zenoh {
            return Ok(Security::Open);
        }
        let (mut endpoints, own) = zenoh
            .endpoints_and_own_protection()
            .map_err(|e| self.document.error_at(at!["zenoh", "config"], e.to_string()))?;
        let sections = || file.nodes.values();
        endpoints.extend(sections().flat_map(|n| n.listen.iter().chain(&n.connect).cloned()));
        match (section.mode, keys) {
            (_, Some(keys)) => Ok(Security::Tls(keys)),
            (Some(SecurityMode::Open), _) => Ok(Security::Open),
            (None, _) if own => Ok(Security::Open),
            (Some(_), _) if own => wrong(
                "mode",
                "[zenoh] config has its own security settings: remove one of them, or set mode = \"open\"",
            ),
            _ => match secret_beyond_its_reach(&endpoints) {
                None => Ok(Security::Secret),
                Some(why) => Err(self.document.error_at(at!["security", "mode"], why)),
            },
        }
    }
}
