//! The nodes of a bench: the four roles, the programs that replace them, and further programs.

use whirlstand_bus::Transport;
use whirlstand_nodes::config::Role;

use super::amount::Seconds;
use super::document::{LaunchError, at};
use super::plan::{PlannedNode, Planner};
use super::schema::{LaunchFile, NodeSection};
use super::wording::unknown;

/// Starting order of the built-in nodes: subscribers come before publishers.
const STARTING: [Role; 5] = [Role::Recorder, Role::Mirror, Role::Estimator, Role::Controller, Role::Plant];

impl Planner<'_> {
    /// The nodes in the order in which they are started.
    pub(super) fn nodes(&self, file: &LaunchFile) -> Result<Vec<PlannedNode>, LaunchError> {
        for (name, section) in &file.nodes {
            self.check_node(file, name, section)?;
        }
        let section = |name: &str| file.nodes.get(name).cloned().unwrap_or_default();
        let roles = STARTING.into_iter().filter(|r| match r {
            Role::Recorder => file.recorder.enabled,
            Role::Mirror => file.mirror.as_ref().is_some_and(|mirror| mirror.enabled),
            // An autopilot has an estimator of its own.
            Role::Estimator => !file.has_autopilot(),
            _ => true,
        });
        let roles =
            roles.map(|r| PlannedNode { name: r.name().into(), role: Some(r), section: section(r.name()) });
        let further = file.nodes.iter().filter(|(name, _)| role(name).is_none());
        let further = further.map(|(name, section)| PlannedNode {
            name: name.clone(),
            role: None,
            section: section.clone(),
        });
        let mut nodes: Vec<_> = roles.chain(further).collect();
        // Foreign programs come last: over a network they are given the addresses of all built-in nodes, but
        // need not announce their own.
        nodes.sort_by_key(|n| n.section.exec.is_some());
        Ok(nodes)
    }

    fn check_node(&self, file: &LaunchFile, name: &str, section: &NodeSection) -> Result<(), LaunchError> {
        let fail = |key: &str, message: String| Err(self.document.error_at(at!["nodes", name, key], message));
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
        if name.is_empty() || name.len() > 32 || !name.chars().all(allowed) {
            return fail(
                "",
                format!(
                    "the name '{name}' cannot be used: 1 to 32 letters, digits, '_', '-' or '.' are expected"
                ),
            );
        }
        if role(name).is_none() && section.exec.is_none() {
            let known = Role::ALL.map(Role::name);
            let message = unknown("node", name, known);
            return fail("", format!("{message}; a node of a new name needs exec = [\"program\", ...]"));
        }
        if section.exec.as_ref().is_some_and(Vec::is_empty) {
            return fail("exec", "a program is expected: exec = [\"program\", \"argument\", ...]".into());
        }
        if section.exec.is_some() && section.external {
            return fail("external", "a node is either started with exec, or external, not both".into());
        }
        if section.external && role(name) == Some(Role::Plant) {
            return fail("external", "the plant ends the run and must be started here".into());
        }
        if section.bridge.is_some() && (section.exec.is_some() || section.external) {
            let key = if section.external { "external" } else { "exec" };
            return fail(key, "a bridge is a built-in node: it cannot have exec or external".into());
        }
        let local = section.exec.is_some() || section.external;
        if local && file.transport == Transport::Inproc {
            return fail("", "with transport = \"inproc\" every node runs inside the launcher".into());
        }
        if section.external && file.transport == Transport::Iceoryx2 && role(name) == Some(Role::Recorder) {
            return fail(
                "external",
                "the report is made from the recorder's log: it must be started here".into(),
            );
        }
        if file.transport != Transport::Zenoh && !(section.listen.is_empty() && section.connect.is_empty()) {
            let key = if section.listen.is_empty() { "connect" } else { "listen" };
            return fail(
                key,
                format!("only transport = \"zenoh\" has endpoints, this bench runs over {}", file.transport),
            );
        }
        if section.lock_memory && section.exec.is_some() {
            return fail(
                "lock_memory",
                "locked memory does not survive exec: let the program call mlockall itself".into(),
            );
        }
        for (key, time) in [
            ("ready_timeout_s", section.ready_timeout_s),
            ("hang_timeout_s", section.hang_timeout_s),
            ("stop_timeout_s", Seconds(section.stop_timeout_s(role(name)))),
        ] {
            self.check_time(at!["nodes", name, key], time.0)?;
        }
        Ok(())
    }
}

fn role(name: &str) -> Option<Role> {
    Role::ALL.into_iter().find(|r| r.name() == name)
}
