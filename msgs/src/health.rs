//! The health of a node, published every 100 ms of wall-clock time.

use crate::define::message;

/// Number of buckets of the latency histogram in [`Health`].
pub const LATENCY_BUCKETS: usize = 32;

/// Upper edge of bucket 0 of the latency histogram, ns.
const FIRST_EDGE_NS: f64 = 500.0;

/// Upper edges of all buckets but the last, open one: a table, because a node needs one in every step.
const UPPER_EDGES_NS: [f64; LATENCY_BUCKETS - 1] = {
    let mut edges = [0.0; LATENCY_BUCKETS - 1];
    let mut i = 0;
    while i < edges.len() {
        let half_octave = if i % 2 == 0 { 1.0 } else { std::f64::consts::SQRT_2 };
        edges[i] = FIRST_EDGE_NS * half_octave * (1u64 << (i / 2)) as f64;
        i += 1;
    }
    edges
};

message! {
    /// Health of one node. `head.step` is the last step done, `head.stamp_ns` wall-clock time since the Unix epoch.
    Health on "health" from node_name {
        /// Number of steps done since the node started.
        steps: u64 => "uint64",
        /// Number of steps with a late or missing answer.
        deadline_misses: u64 => "uint64",
        /// Number of messages lost on the way to this node, from gaps in sequence numbers.
        lost: u64 => "uint64",
        /// Number of messages refused: not finite, stale, repeated, out of range.
        rejected: u64 => "uint64",
        /// Largest latency since the node started, ns.
        latency_max_ns: u64 => "uint64",
        /// Latency histogram since the node started; see [`latency_bucket`]. The plant counts from publishing
        /// `Imu` to receiving its `Command`, the other nodes from receiving to answering.
        latency: u32[LATENCY_BUCKETS] => "uint32[32]",
        /// Operating-system process number.
        pid: u32 => "uint32",
        /// State of the node, a [`NodeState`].
        state: u32 => "uint32",
        /// Name of the node, UTF-8, padded with zeros.
        node: u8[32] => "uint8[32]",
    }
}

impl Health {
    /// Name of the node.
    pub fn node_name(&self) -> &str {
        let end = self.node.iter().position(|&b| b == 0).unwrap_or(self.node.len());
        std::str::from_utf8(&self.node[..end]).unwrap_or("")
    }

    /// Sets the node's name, truncated at a character boundary.
    pub fn set_node_name(&mut self, name: &str) {
        self.node = [0; 32];
        let mut end = name.len().min(self.node.len());
        while !name.is_char_boundary(end) {
            end -= 1;
        }
        self.node[..end].copy_from_slice(&name.as_bytes()[..end]);
    }
}

/// State of a node, as a number in [`Health::state`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum NodeState {
    /// Connecting, waiting for its peers.
    Starting = 0,
    /// In the loop.
    Running = 1,
    /// The plant holds its inputs at neutral.
    Failsafe = 2,
    /// Shutting down.
    Stopping = 3,
    /// A bridge in the loop sends neutral, because nobody has armed.
    Disarmed = 4,
    /// A bridge in the loop leaves the vehicle to its pilot.
    Manual = 5,
}

impl NodeState {
    /// The state for a number in [`Health::state`]; `None` for an unknown number.
    pub fn from_u32(value: u32) -> Option<Self> {
        let all =
            [Self::Starting, Self::Running, Self::Failsafe, Self::Stopping, Self::Disarmed, Self::Manual];
        all.into_iter().find(|s| *s as u32 == value)
    }
}

/// Bucket of a latency: two buckets an octave from 0.5 us, the last one open.
pub fn latency_bucket(latency_ns: u64) -> usize {
    let latency_ns = latency_ns as f64;
    UPPER_EDGES_NS.partition_point(|&edge| edge <= latency_ns)
}

/// Upper edge of a bucket, ns; infinite for the last one.
pub fn latency_bucket_upper_ns(bucket: usize) -> f64 {
    UPPER_EDGES_NS.get(bucket).copied().unwrap_or(f64::INFINITY)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Message;

    #[test]
    fn every_latency_is_below_its_upper_edge_and_above_the_one_before() {
        for ns in (0..10_000u64).chain((1..60).map(|e| (1.3f64.powi(e) * 7.0) as u64)) {
            let b = latency_bucket(ns);
            assert!((ns as f64) < latency_bucket_upper_ns(b), "{ns} ns in bucket {b}");
            assert!(
                b == 0 || ns as f64 >= latency_bucket_upper_ns(b - 1) * (1.0 - 1e-12),
                "{ns} ns in bucket {b}"
            );
        }
    }

    #[test]
    fn names_survive_even_when_they_are_cut() {
        let mut h = Health::zeroed();
        h.set_node_name("plant");
        assert_eq!(h.node_name(), "plant");
        h.set_node_name("ä".repeat(20).as_str());
        assert_eq!(h.node_name(), "ä".repeat(16));
    }
}
