//! `[mirror]`: who holds the flight against the vehicle file, and what is done about a finding.

use whirlstand_nodes::config::{MirrorConfig, OnFinding};

use super::document::{LaunchError, at};
use super::plan::Planner;
use super::schema::LaunchFile;
use super::wording::unknown;

impl Planner<'_> {
    /// Options of the mirror, if one flies.
    pub(super) fn mirror(&self, file: &LaunchFile) -> Result<Option<MirrorConfig>, LaunchError> {
        let Some(section) = file.mirror.as_ref() else { return Ok(None) };
        let fail = |message: String| Err(self.document.error_at(at!["mirror", "on_finding"], message));
        let on_finding = match section.on_finding.as_str() {
            "tell" => OnFinding::Tell,
            "failsafe" if file.has_autopilot() => {
                return fail(
                    "an autopilot has its own failsafe, which the bench does not reach: use \"tell\"".into(),
                );
            }
            "failsafe" => OnFinding::Failsafe,
            "law" => {
                return fail(
                    "a law is not changed in flight yet: use \"tell\" or \"failsafe\", and `whirlstand tune` after the flight"
                        .into(),
                );
            }
            other => return fail(unknown("value", other, ["tell", "failsafe"])),
        };
        Ok(section.enabled.then_some(MirrorConfig { on_finding }))
    }
}

#[cfg(test)]
mod tests {
    use whirlstand_nodes::config::{OnFinding, Role};

    use crate::cli::OverrideArgs;
    use crate::file::builtin::FoundFile;
    use crate::file::document::{Document, LaunchError};
    use crate::file::jobs::jobs_of;
    use crate::file::plan::Plan;

    fn plan(section: &str) -> Result<Plan, LaunchError> {
        let text = format!("vehicle = 'quadrotor'\ncontroller.law = 'smc'\n{section}");
        let document = Document::parse("a.toml", &text)?;
        let file = FoundFile { document, name: "a".into(), folder: ".".into() };
        Ok(jobs_of(&file, &OverrideArgs::default(), false)?.runs.remove(0).plan)
    }

    #[test]
    fn a_mirror_flies_where_it_is_asked_for() {
        let flies = |plan: &Plan| plan.nodes.iter().any(|n| n.role == Some(Role::Mirror));
        let without = plan("").unwrap();
        assert!(!flies(&without) && without.config.mirror.is_none());
        let told = plan("[mirror]\n").unwrap();
        assert!(flies(&told) && told.config.peers.contains(&Role::Mirror));
        assert_eq!(told.config.mirror.unwrap().on_finding, OnFinding::Tell);
        let safe = plan("[mirror]\non_finding = 'failsafe'\n").unwrap();
        assert_eq!(safe.config.mirror.unwrap().on_finding, OnFinding::Failsafe);
        let off = plan("[mirror]\nenabled = false\n").unwrap();
        assert!(!flies(&off) && off.config.mirror.is_none());
        for (value, word) in
            [("law", "not changed in flight"), ("tel", "did you mean 'tell'"), ("x", "known are")]
        {
            let error = plan(&format!("[mirror]\non_finding = '{value}'\n")).unwrap_err();
            assert!(error.place.contains("line 4") && error.message.contains(word), "{error}");
        }
    }
}
