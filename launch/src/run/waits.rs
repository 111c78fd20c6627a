//! The reason and the duration for which a bench waits, as its nodes report them.

use std::collections::BTreeMap;
use std::time::Instant;

use whirlstand_nodes::WAITING_FOR;
use whirlstand_nodes::config::Role;

/// The nodes that are waiting.
#[derive(Debug, Default)]
pub(super) struct Waits {
    /// For each node, what it waits for and since when.
    by_node: BTreeMap<String, (String, Instant)>,
}

impl Waits {
    /// Takes in the status text of a node.
    pub fn hear(&mut self, node: &str, status: &str, now: Instant) {
        match status.strip_prefix(WAITING_FOR) {
            Some(whom) if self.by_node.get(node).is_some_and(|(known, _)| known == whom) => {}
            Some(whom) => {
                self.by_node.insert(node.into(), (whom.into(), now));
            }
            None => self.forget(node),
        }
    }

    /// Forgets a node, because its process has been replaced.
    pub fn forget(&mut self, node: &str) {
        self.by_node.remove(node);
    }

    /// A text such as "waiting for PX4 on tcp 4560 (12 s)"; `None` while no node waits. The plant waits for all
    /// others, so another waiting node, which knows more, comes first.
    pub fn text(&self, now: Instant) -> Option<String> {
        let others: Vec<_> = self.by_node.iter().filter(|(node, _)| *node != Role::Plant.name()).collect();
        let told = match others.is_empty() {
            true => self.by_node.iter().collect(),
            false => others,
        };
        let seconds = |since: Instant| now.saturating_duration_since(since).as_secs();
        let texts: Vec<_> =
            told.iter().map(|(_, (whom, since))| format!("{whom} ({} s)", seconds(*since))).collect();
        (!texts.is_empty()).then(|| format!("{WAITING_FOR}{}", texts.join(" and ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn who_waits_longest_down_the_chain_names_whom_all_wait_for() {
        let start = Instant::now();
        let after = |s| start + Duration::from_secs(s);
        let mut waits = Waits::default();
        assert_eq!(waits.text(start), None);
        waits.hear("plant", "waiting for the first command", after(1));
        assert_eq!(waits.text(after(4)).unwrap(), "waiting for the first command (3 s)");
        waits.hear("controller", "waiting for PX4 on tcp 4560", after(2));
        waits.hear("controller", "waiting for PX4 on tcp 4560", after(9));
        assert_eq!(waits.text(after(14)).unwrap(), "waiting for PX4 on tcp 4560 (12 s)");
        waits.hear("controller", "", after(15));
        waits.forget("plant");
        assert_eq!(waits.text(after(15)), None);
    }
}
