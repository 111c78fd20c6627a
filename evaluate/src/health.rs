//! Health of the nodes as a run's log has it.

use whirlstand_msgs::{Health, LATENCY_BUCKETS};

/// Health of one node.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeHealth {
    /// Name of the node.
    pub node: String,
    /// The last report of each process of the node: a report with another process number, or with fewer steps than the
    /// one before, belongs to the next process.
    pub lives: Vec<Health>,
}

impl NodeHealth {
    /// Takes a report into the list of all nodes, in the order of the log.
    pub(crate) fn take(nodes: &mut Vec<Self>, report: Health) {
        let name = report.node_name();
        let Some(node) = nodes.iter_mut().find(|node| node.node == name) else {
            nodes.push(Self { node: name.into(), lives: vec![report] });
            return;
        };
        match node.lives.last_mut() {
            Some(last) if last.pid == report.pid && last.steps <= report.steps => *last = report,
            _ => node.lives.push(report),
        }
    }

    /// Latency histogram of all processes of the node together.
    pub fn histogram(&self) -> [u64; LATENCY_BUCKETS] {
        let mut sum = [0; LATENCY_BUCKETS];
        for life in &self.lives {
            for (s, c) in sum.iter_mut().zip(&life.latency) {
                *s += u64::from(*c);
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::Message;

    #[test]
    fn each_process_of_a_node_leaves_its_last_report() {
        let mut nodes = Vec::new();
        for (pid, steps) in [(7, 10), (7, 20), (8, 5), (8, 9), (8, 2)] {
            let mut report = Health { pid, steps, ..Health::zeroed() };
            report.set_node_name("plant");
            NodeHealth::take(&mut nodes, report);
        }
        let lives: Vec<_> = nodes[0].lives.iter().map(|life| (life.pid, life.steps)).collect();
        assert_eq!((nodes.len(), lives), (1, vec![(7, 20), (8, 9), (8, 2)]));
    }
}
