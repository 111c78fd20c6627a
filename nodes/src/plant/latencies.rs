//! Latencies of answers.

use hdrhistogram::Histogram;

use crate::error::NodeError;

/// Largest latency of the histogram, ns; longer ones count as this.
const LONGEST_NS: u64 = 60_000_000_000;

/// A histogram of latencies, ns, with three digits.
pub(super) fn latencies() -> Result<Histogram<u64>, NodeError> {
    Histogram::new_with_bounds(1, LONGEST_NS, 3).map_err(|e| NodeError::Config {
        field: "latency".into(),
        value: LONGEST_NS.to_string(),
        reason: e.to_string(),
    })
}
