//! The latest `Health` of each node, with counts summed over restarts.

use std::collections::BTreeMap;
use std::time::Instant;

use whirlstand_evaluate::metrics::total;
use whirlstand_msgs::{Health, LATENCY_BUCKETS, NodeState};

/// Counts of one node over the whole run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Counts {
    pub steps: u64,
    pub deadline_misses: u64,
    pub lost: u64,
    pub rejected: u64,
    pub latency_max_ns: u64,
    pub latency: [u64; LATENCY_BUCKETS],
}

impl Counts {
    fn of(health: &Health) -> Self {
        Self {
            steps: health.steps,
            deadline_misses: health.deadline_misses,
            lost: health.lost,
            rejected: health.rejected,
            latency_max_ns: health.latency_max_ns,
            latency: health.latency.map(u64::from),
        }
    }

    /// Sum of two counts, saturating at the greatest number, because a report can hold any value.
    fn plus(mut self, other: &Self) -> Self {
        self.steps = self.steps.saturating_add(other.steps);
        self.deadline_misses = self.deadline_misses.saturating_add(other.deadline_misses);
        self.lost = self.lost.saturating_add(other.lost);
        self.rejected = self.rejected.saturating_add(other.rejected);
        self.latency_max_ns = self.latency_max_ns.max(other.latency_max_ns);
        self.latency.iter_mut().zip(other.latency).for_each(|(a, b)| *a = a.saturating_add(b));
        self
    }
}

/// Health of one node over the whole run.
#[derive(Debug, Clone)]
pub(crate) struct NodeHealth {
    /// The latest message.
    pub latest: Health,
    /// Time of arrival of the latest message.
    pub received_at: Instant,
    /// Counts of the node's earlier processes.
    before: Counts,
    failsafe: Failsafe,
}

/// Steps that a node spent in failsafe. A node reports every change of its state at once, with its step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Failsafe {
    /// Steps over the whole run.
    pub steps: u64,
    /// Steps of the last failsafe, if the node has not left it.
    pub at_end: u64,
}

impl Failsafe {
    /// Takes in the report that follows `before`.
    fn update(&mut self, before: &Health, now: &Health) {
        let in_failsafe = |h: &Health| NodeState::from_u32(h.state) == Some(NodeState::Failsafe);
        if in_failsafe(before) && before.pid == now.pid {
            let steps = now.head.step.saturating_sub(before.head.step);
            self.steps = self.steps.saturating_add(steps);
            self.at_end = self.at_end.saturating_add(steps);
        }
        // A stopping node reports that state in place of whether commands arrived.
        if !in_failsafe(now) && NodeState::from_u32(now.state) != Some(NodeState::Stopping) {
            self.at_end = 0;
        }
    }
}

impl NodeHealth {
    /// Counts over all processes of the node.
    pub fn counts(&self) -> Counts {
        Counts::of(&self.latest).plus(&self.before)
    }

    /// Steps in failsafe, according to the node's reports.
    pub fn failsafe(&self) -> Failsafe {
        self.failsafe
    }
}

/// The latest health of every node.
#[derive(Debug, Clone, Default)]
pub(crate) struct HealthTable(BTreeMap<String, NodeHealth>);

impl HealthTable {
    /// Takes in one message. A new process number means that the node was restarted.
    pub fn update(&mut self, health: Health, now: Instant) {
        let name = health.node_name().to_string();
        match self.0.get_mut(&name) {
            None => {
                let (before, failsafe) = (Counts::default(), Failsafe::default());
                self.0.insert(name, NodeHealth { latest: health, received_at: now, before, failsafe });
            }
            Some(known) => {
                if known.latest.pid != health.pid {
                    known.before = known.counts();
                }
                known.failsafe.update(&known.latest, &health);
                known.latest = health;
                known.received_at = now;
            }
        }
    }

    /// Health of one node; `None` before its first message.
    pub fn get(&self, node: &str) -> Option<&NodeHealth> {
        self.0.get(node)
    }

    /// Health of all nodes, by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &NodeHealth)> {
        self.0.iter().map(|(name, health)| (name.as_str(), health))
    }

    /// State of a node.
    pub fn state(&self, node: &str) -> Option<NodeState> {
        NodeState::from_u32(self.get(node)?.latest.state)
    }

    /// Messages lost, over all nodes.
    pub fn lost(&self) -> u64 {
        total(self.0.values().map(|n| n.counts().lost))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::Message;

    fn health(pid: u32, steps: u64, lost: u64) -> Health {
        let mut health = Health { pid, steps, lost, ..Health::zeroed() };
        health.set_node_name("controller");
        health
    }

    #[test]
    fn counts_add_up_over_restarts() {
        let mut table = HealthTable::default();
        for (pid, steps, lost) in [(7, 10, 0), (7, 20, 1), (8, 5, 0), (8, 6, 2), (9, 1, 0)] {
            table.update(health(pid, steps, lost), Instant::now());
        }
        let counts = table.get("controller").unwrap().counts();
        assert_eq!((counts.steps, counts.lost, table.lost()), (20 + 6 + 1, 3, 3));
        assert!(table.get("plant").is_none());
    }

    #[test]
    fn steps_in_failsafe_are_counted_from_the_changes_of_state() {
        let table = |reports: &[(u64, NodeState)]| {
            let mut table = HealthTable::default();
            for &(step, state) in reports {
                let mut health = Health { pid: 7, state: state as u32, ..Health::zeroed() };
                health.head.step = step;
                health.set_node_name("plant");
                table.update(health, Instant::now());
            }
            let failsafe = table.get("plant").unwrap().failsafe();
            (failsafe.steps, failsafe.at_end)
        };
        use NodeState::{Failsafe, Running, Stopping};
        let back = [(5, Running), (10, Failsafe), (12, Failsafe), (17, Running), (40, Stopping)];
        assert_eq!(table(&back), (7, 0));
        assert_eq!(
            table(&[(5, Running), (10, Failsafe), (17, Running), (30, Failsafe), (40, Stopping)]),
            (17, 10)
        );
    }

    #[test]
    fn counts_of_no_node_stay_at_the_greatest_number() {
        let mut table = HealthTable::default();
        for (pid, steps) in [(7, 485), (8, u64::MAX - 484), (7, 486), (9, u64::MAX)] {
            table.update(health(pid, steps, u64::MAX), Instant::now());
        }
        assert_eq!((table.get("controller").unwrap().counts().steps, table.lost()), (u64::MAX, u64::MAX));
    }
}
