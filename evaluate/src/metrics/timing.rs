//! Timing figures from the health messages of a run.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use whirlstand_msgs::latency_bucket_upper_ns;

use super::ChargeSteps;
use crate::health::NodeHealth;

/// Percentiles of a latency, us. Each is the upper edge of the histogram's bucket that holds it (two buckets an
/// octave), so the true value is at most 29 % lower; never more than `max`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    /// Median of the latency, us.
    pub p50_us: f64,
    /// 99 % quantile of the latency, us.
    pub p99_us: f64,
    /// 99.9 % quantile of the latency, us.
    pub p999_us: f64,
    /// Greatest latency, us.
    pub max_us: f64,
    /// Number of answers.
    pub count: u64,
}

/// Timing figures of one node, over all processes that it had.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeTiming {
    /// Number of steps done.
    pub steps: u64,
    /// Number of steps whose answer came too late or not at all.
    pub deadline_misses: u64,
    /// Number of messages lost on the way to the node.
    pub lost: u64,
    /// Number of messages refused: not finite, stale, repeated or out of range.
    pub rejected: u64,
    /// How often the node was started again.
    pub restarts: u64,
    /// Time from a message to the answer of the node; for the plant, from a measurement to the command that answers it.
    /// `None` without an answer.
    pub latency: Option<Latency>,
}

/// Timing figures of a run.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Number of deadline misses of the plant.
    pub deadline_misses: u64,
    /// Number of steps over which the last command was held because the new one was late or not usable.
    pub held_steps: u64,
    /// Number of steps in failsafe.
    pub failsafe_steps: u64,
    /// Share of the steps in failsafe, from 0 to 1.
    #[serde(default)]
    pub failsafe_share: f64,
    /// Number of steps in failsafe at the end of the run, from which the plant did not come back.
    #[serde(default)]
    pub failsafe_at_end: u64,
    /// Behind a bridge: share of the steps in which nobody was in charge, from the first armed one on; 1 when nobody armed.
    /// `None` when it was not measured.
    #[serde(default)]
    pub disarmed_share: Option<f64>,
    /// Behind a bridge to a vehicle: share of the same steps in which the pilot was in charge. `None` when it was not
    /// measured.
    #[serde(default)]
    pub pilot_share: Option<f64>,
    /// Number of messages lost, all nodes together.
    pub lost: u64,
    /// Number of restarts, all nodes together.
    pub restarts: u64,
    /// Figures node by node.
    pub nodes: BTreeMap<String, NodeTiming>,
}

/// Percentiles from a latency histogram in the buckets of [`whirlstand_msgs::latency_bucket`]; `None` when empty.
pub fn latency(histogram: &[u64], max_ns: u64) -> Option<Latency> {
    let count = total(histogram.iter().copied());
    if count == 0 {
        return None;
    }
    let max_us = max_ns as f64 * 1e-3;
    let percentile = |p: f64| {
        let rank = ((p * count as f64).ceil() as u64).clamp(1, count);
        let mut seen = 0;
        let bucket = histogram.iter().position(|c| {
            seen = c.saturating_add(seen);
            seen >= rank
        });
        (bucket.map_or(f64::INFINITY, latency_bucket_upper_ns) * 1e-3).min(max_us)
    };
    Some(Latency {
        p50_us: percentile(0.5),
        p99_us: percentile(0.99),
        p999_us: percentile(0.999),
        max_us,
        count,
    })
}

/// The sum of counts, saturating at the greatest number, because a log can hold any values.
pub fn total(counts: impl IntoIterator<Item = u64>) -> u64 {
    counts.into_iter().fold(0, u64::saturating_add)
}

fn node_timing(health: &NodeHealth) -> NodeTiming {
    let lives = &health.lives;
    let sum = |f: fn(&whirlstand_msgs::Health) -> u64| total(lives.iter().map(f));
    let max_ns = lives.iter().map(|h| h.latency_max_ns).max().unwrap_or(0);
    NodeTiming {
        steps: sum(|h| h.steps),
        deadline_misses: sum(|h| h.deadline_misses),
        lost: sum(|h| h.lost),
        rejected: sum(|h| h.rejected),
        restarts: lives.len().saturating_sub(1) as u64,
        latency: latency(&health.histogram(), max_ns),
    }
}

/// Steps of a run in failsafe.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct FailsafeSteps {
    /// All steps in failsafe.
    pub steps: u64,
    /// Consecutive steps in failsafe at the end.
    pub at_end: u64,
    /// Steps of the run.
    pub of_steps: u64,
}

impl Timing {
    /// Adds the shares of steps in which nobody or the pilot was in charge behind a bridge.
    pub(crate) fn witness_charge(&mut self, steps: &ChargeSteps) {
        (self.disarmed_share, self.pilot_share) = steps.shares().unzip();
        self.witness_failsafe(steps.failsafe, steps.failsafe_at_end, steps.of_steps());
    }

    /// Replaces the counts of failsafe steps by those of another source where they are greater: a log can lack
    /// reports of the nodes, and the other way round.
    pub fn witness_failsafe(&mut self, steps_in_failsafe: u64, at_end: u64, of_steps: u64) {
        self.failsafe_steps = self.failsafe_steps.max(steps_in_failsafe);
        self.failsafe_at_end = self.failsafe_at_end.max(at_end);
        let share = steps_in_failsafe as f64 / of_steps.max(steps_in_failsafe).max(1) as f64;
        self.failsafe_share = self.failsafe_share.max(share);
    }
}

/// Timing figures of a run from the health of its nodes and its numbers of held steps and of steps in failsafe. Misses are
/// counted by the plant; without its health, held steps stand for them.
pub(crate) fn timing(health: &[NodeHealth], held_steps: u64, failsafe: FailsafeSteps) -> Timing {
    let nodes: BTreeMap<String, NodeTiming> =
        health.iter().map(|h| (h.node.clone(), node_timing(h))).collect();
    let mut timing = Timing {
        deadline_misses: nodes.get("plant").map_or(held_steps, |p| p.deadline_misses),
        held_steps,
        lost: total(nodes.values().map(|n| n.lost)),
        restarts: total(nodes.values().map(|n| n.restarts)),
        nodes,
        ..Timing::default()
    };
    timing.witness_failsafe(failsafe.steps, failsafe.at_end, failsafe.of_steps);
    timing
}

#[cfg(test)]
mod tests {
    use super::*;
    use whirlstand_msgs::{LATENCY_BUCKETS, latency_bucket};

    #[test]
    fn percentiles_bound_the_true_ones_from_above_within_a_bucket() {
        let mut ns: Vec<u64> = (0..10_000u64).map(|i| 20_000 + (i * i) % 80_000).collect();
        let mut histogram = [0u64; LATENCY_BUCKETS];
        ns.iter().for_each(|l| histogram[latency_bucket(*l)] += 1);
        ns.sort_unstable();
        let l = latency(&histogram, ns[9_999]).unwrap();
        for (found, rank) in [(l.p50_us, 4_999), (l.p99_us, 9_899), (l.p999_us, 9_989)] {
            let truth = ns[rank] as f64 * 1e-3;
            assert!(found >= truth && found <= truth * 2f64.sqrt(), "{found} {truth}");
        }
        assert_eq!((l.max_us, l.count), (ns[9_999] as f64 * 1e-3, 10_000));
        assert!(latency(&[0; LATENCY_BUCKETS], 0).is_none());
    }

    #[test]
    fn counts_of_a_forged_log_stay_at_the_greatest_number() {
        assert_eq!(total([u64::MAX - 484, 1000]), u64::MAX);
        let l = latency(&[u64::MAX, 7, u64::MAX], 1).unwrap();
        assert_eq!(l.count, u64::MAX);
    }
}
