//! `[mirror]`: which node compares the flight with the vehicle file, and the reaction to a finding.

use whirlstand_nodes::config::{LawKind, MirrorConfig, OnFinding, Role};

use super::document::{LaunchError, at};
use super::plan::Planner;
use super::schema::LaunchFile;
use super::wording::unknown;

impl Planner<'_> {
    /// Options of the mirror; `None` when it does not fly.
    pub(super) fn mirror(&self, file: &LaunchFile) -> Result<Option<MirrorConfig>, LaunchError> {
        let Some(section) = file.mirror.as_ref() else { return Ok(None) };
        let fail = |message: String| Err(self.document.error_at(at!["mirror", "on_finding"], message));
        let on_finding = match section.on_finding.as_str() {
            "tell" => OnFinding::Tell,
            "failsafe" if file.has_autopilot() => {
                return fail(
                    "an autopilot has its own failsafe, which the bench cannot trigger: use \"tell\"".into(),
                );
            }
            "failsafe" => OnFinding::Failsafe,
            "law" if file.has_autopilot() => {
                return fail(
                    "an autopilot has its own laws, which the bench cannot redesign: use \"tell\"".into(),
                );
            }
            "law" if file.controller.law == LawKind::Manual => {
                return fail(
                    "controller.law = \"manual\" has no law to design: use \"tell\" or \"failsafe\"".into(),
                );
            }
            "law" if is_foreign(file) => {
                return fail(
                    "an external controller has its own laws, which the bench cannot redesign: use \"tell\""
                        .into(),
                );
            }
            "law" => OnFinding::Law,
            other => return fail(unknown("value", other, ["tell", "failsafe", "law"])),
        };
        Ok(section.enabled.then_some(MirrorConfig { on_finding }))
    }
}

/// Whether the controller is a program or hardware from outside the bench.
fn is_foreign(file: &LaunchFile) -> bool {
    file.nodes.get(Role::Controller.name()).is_some_and(|n| n.exec.is_some() || n.external)
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
        plan_under("smc", section)
    }

    fn plan_under(law: &str, section: &str) -> Result<Plan, LaunchError> {
        let text = format!("vehicle = 'quadrotor'\ncontroller.law = '{law}'\n{section}");
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
        let law = plan("[mirror]\non_finding = 'law'\n").unwrap();
        assert_eq!(law.config.mirror.unwrap().on_finding, OnFinding::Law);
        let stick = plan_under("manual", "[mirror]\non_finding = 'law'\n").unwrap_err();
        assert!(stick.message.contains("no law to design"), "{stick}");
        let foreign =
            plan("[mirror]\non_finding = 'law'\n[nodes.controller]\nexec = ['true']\n").unwrap_err();
        assert!(foreign.message.contains("external controller"), "{foreign}");
        for (value, word) in [("tel", "did you mean 'tell'"), ("x", "known are")] {
            let error = plan(&format!("[mirror]\non_finding = '{value}'\n")).unwrap_err();
            assert!(error.place.contains("line 4") && error.message.contains(word), "{error}");
        }
    }
}
