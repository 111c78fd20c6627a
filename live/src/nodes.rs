//! The state of the nodes, from their own reports.

use std::collections::BTreeMap;
use std::time::Instant;

use serde::Serialize;
use whirlstand_msgs::{Health, LATENCY_BUCKETS, NodeState, latency_bucket_upper_ns};

use crate::cpu::CpuMeter;

/// Time without a report after which a node counts as silent: five times the period of health reports.
const SILENT_S: f64 = 0.5;

/// The data of a node that are shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct NodeRow {
    pub node: String,
    pub state: &'static str,
    pub steps: u64,
    pub misses: u64,
    pub lost: u64,
    pub rejected: u64,
    pub restarts: u32,
    /// Upper edge of the bucket that contains the median latency, us.
    pub median_us: Option<f64>,
    /// Upper edge of the bucket that contains the 99 % quantile of the latencies, us.
    pub p99_us: Option<f64>,
    pub max_us: Option<f64>,
    /// Histogram of the latencies, two buckets per octave from 0.5 us.
    pub latency: Vec<u32>,
    /// Share of one processor, %; `None` for a process of another machine.
    pub cpu_percent: Option<f64>,
}

struct Known {
    health: Health,
    heard: Instant,
    restarts: u32,
    cpu: CpuMeter,
}

/// All nodes that have sent a report.
#[derive(Default)]
pub(crate) struct Nodes {
    known: BTreeMap<String, Known>,
    /// Whether the processes run on this machine now.
    is_here: bool,
}

impl Nodes {
    /// Nodes of a running bench, whose processes may be measured.
    pub fn running() -> Self {
        Self { is_here: true, ..Self::default() }
    }

    pub fn hear(&mut self, health: &Health, now: Instant) {
        let name = health.node_name();
        let is_here = self.is_here;
        let known = self.known.entry(name.into()).or_insert_with(|| Known {
            health: *health,
            heard: now,
            restarts: 0,
            cpu: CpuMeter::default(),
        });
        known.restarts += u32::from(known.health.pid != health.pid);
        (known.health, known.heard) = (*health, now);
        if is_here {
            known.cpu.look(name, health.pid, now);
        }
    }

    /// Whether a node has reported its end and has not been replaced.
    pub fn has_stopped(&self, name: &str) -> bool {
        self.known.get(name).is_some_and(|known| known.health.state == NodeState::Stopping as u32)
    }

    /// Whether a node has sent a report.
    pub fn is_known(&self, name: &str) -> bool {
        self.known.contains_key(name)
    }

    /// The rows of all nodes, by name.
    pub fn rows(&self, now: Instant) -> Vec<NodeRow> {
        self.known.iter().map(|(name, known)| self.row(name, known, now)).collect()
    }

    fn row(&self, name: &str, known: &Known, now: Instant) -> NodeRow {
        let health = &known.health;
        let silent = self.is_here && now.duration_since(known.heard).as_secs_f64() > SILENT_S;
        let state = match NodeState::from_u32(health.state) {
            Some(NodeState::Stopping) => "stopping",
            _ if silent => "silent",
            Some(NodeState::Starting) => "starting",
            Some(NodeState::Running) => "running",
            Some(NodeState::Failsafe) => "failsafe",
            Some(NodeState::Disarmed) => "disarmed",
            Some(NodeState::Manual) => "manual",
            None => "unknown",
        };
        NodeRow {
            node: name.into(),
            state,
            steps: health.steps,
            misses: health.deadline_misses,
            lost: health.lost,
            rejected: health.rejected,
            restarts: known.restarts,
            median_us: quantile_us(&health.latency, 0.5),
            p99_us: quantile_us(&health.latency, 0.99),
            max_us: (health.latency_max_ns > 0).then_some(health.latency_max_ns as f64 * 1e-3),
            latency: health.latency.to_vec(),
            cpu_percent: known.cpu.percent(),
        }
    }
}

/// Upper edge of the bucket in which this quantile of the latencies is, us; `None` without latencies, and for the
/// open last bucket.
fn quantile_us(counts: &[u32; LATENCY_BUCKETS], share: f64) -> Option<f64> {
    let all: u64 = counts.iter().map(|c| u64::from(*c)).sum();
    let wanted = (all as f64 * share).ceil().max(1.0) as u64;
    let mut sum = 0;
    let bucket = counts.iter().position(|c| {
        sum += u64::from(*c);
        sum >= wanted
    })?;
    Some(latency_bucket_upper_ns(bucket) * 1e-3).filter(|us| us.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{Message, latency_bucket};

    #[test]
    fn a_node_with_another_process_number_was_restarted() {
        let now = Instant::now();
        let mut nodes = Nodes::default();
        let mut health = Health { pid: 7, state: NodeState::Running as u32, ..Health::zeroed() };
        health.set_node_name("plant");
        health.latency[latency_bucket(9_000)] = 99;
        health.latency[latency_bucket(90_000)] = 1;
        nodes.hear(&health, now);
        health.pid = 8;
        nodes.hear(&health, now);
        let row = &nodes.rows(now)[0];
        assert_eq!((row.node.as_str(), row.state, row.restarts), ("plant", "running", 1));
        let median = row.median_us.unwrap();
        assert!((9.0..14.0).contains(&median) && row.p99_us == row.median_us, "{row:?}");
        assert_eq!(quantile_us(&[0; LATENCY_BUCKETS], 0.5), None);
    }
}
