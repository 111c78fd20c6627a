//! The latest `Health` of each node, with counts summed over restarts.

use std::collections::BTreeMap;
use std::time::Instant;

use whirlstand_evaluate::metrics::{ChargeSteps, total};
use whirlstand_msgs::{Health, LATENCY_BUCKETS, NodeState, charge};

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
    charge: ChargeSteps,
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

    /// Steps by who was in charge, according to the reports of a bridge.
    pub fn charge(&self) -> &ChargeSteps {
        &self.charge
    }

    /// Takes in the report that follows the latest one.
    fn update(&mut self, health: Health, now: Instant) {
        let before = self.latest;
        if before.pid != health.pid {
            self.before = self.counts();
        } else if let Some(in_charge) = in_charge(&before) {
            self.charge.take(in_charge, health.head.step.saturating_sub(before.head.step));
        }
        self.failsafe.update(&before, &health);
        self.latest = health;
        self.received_at = now;
    }
}

/// Who was in charge in the steps that follow a report; `None` outside the loop.
fn in_charge(health: &Health) -> Option<u32> {
    match NodeState::from_u32(health.state)? {
        NodeState::Running => Some(charge::CONTROLLER),
        NodeState::Failsafe => Some(charge::FAILSAFE),
        NodeState::Disarmed => Some(charge::NOBODY),
        NodeState::Manual => Some(charge::PILOT),
        NodeState::Starting | NodeState::Stopping => None,
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
                let node = NodeHealth {
                    latest: health,
                    received_at: now,
                    before: Counts::default(),
                    failsafe: Failsafe::default(),
                    charge: ChargeSteps::default(),
                };
                self.0.insert(name, node);
            }
            Some(known) => known.update(health, now),
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
    fn who_was_in_charge_is_counted_from_the_changes_of_state_of_a_bridge() {
        use NodeState::{Disarmed, Failsafe, Manual, Running, Starting, Stopping};
        let shares = |reports: &[(u32, u64, NodeState)]| {
            let mut table = HealthTable::default();
            for &(pid, step, state) in reports {
                let mut health = Health { pid, state: state as u32, ..Health::zeroed() };
                health.head.step = step;
                health.set_node_name("plant");
                table.update(health, Instant::now());
            }
            table.get("plant").unwrap().charge().shares()
        };
        assert_eq!(shares(&[(7, 0, Starting), (7, 0, Stopping)]), None, "no step");
        let never = [(7, 0, Starting), (7, 0, Disarmed), (7, 50, Disarmed), (7, 90, Stopping)];
        assert_eq!(shares(&never), Some((1.0, 0.0)));
        let flown = [(7, 0, Disarmed), (7, 100, Running), (7, 500, Stopping)];
        assert_eq!(shares(&flown), Some((0.0, 0.0)));
        let mixed =
            [(7, 0, Disarmed), (7, 9, Running), (7, 19, Manual), (7, 39, Disarmed), (7, 49, Failsafe)];
        assert_eq!(shares(&[&mixed[..], &[(7, 109, Stopping)]].concat()), Some((0.1, 0.2)));
        let replaced = [(7, 0, Running), (7, 40, Running), (8, 0, Disarmed), (8, 10, Stopping)];
        assert_eq!(shares(&replaced), Some((0.2, 0.0)), "the steps of two processes add up");
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
