//! What an effect on single samples is, and how such samples are counted.

use std::collections::BTreeMap;

use whirlstand_vehicle::Kind;

/// An effect on single samples of a channel, such as rounding or clipping.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleEffect {
    /// Kind of the effect.
    pub kind: Kind,
    /// Index of the channel.
    pub channel: usize,
    /// Parameters by name: value, lower and upper end of the 95 % interval, SI.
    pub parameters: BTreeMap<&'static str, (f64, f64, f64)>,
    /// Number of samples affected.
    pub samples: usize,
}

/// 95 % interval of a proportion, `count` of `n` (Wilson).
pub(crate) fn share_interval(count: f64, n: f64) -> (f64, f64) {
    let z2 = 1.96f64 * 1.96;
    let centre = (count + 0.5 * z2) / (n + z2);
    let half = 1.96 * (count * (1.0 - count / n) + 0.25 * z2).sqrt() / (n + z2);
    ((centre - half).max(0.0), centre + half)
}

pub(crate) fn longest_run(sorted: &[usize]) -> usize {
    let (mut longest, mut run) = (0, 0);
    for (i, k) in sorted.iter().enumerate() {
        run = if i > 0 && sorted[i - 1] + 1 == *k { run + 1 } else { 1 };
        longest = longest.max(run);
    }
    longest
}
