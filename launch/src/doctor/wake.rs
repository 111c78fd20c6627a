//! A short measurement of how late this machine wakes a sleeping process.

use serde::Serialize;
use whirlstand_nodes::config::RealtimeOptions;
use whirlstand_nodes::os::{MonotonicTime, apply_realtime, sleep_until};

use super::checks::TRIED_PRIORITY;
use crate::error::Failure;

/// Deadlines of one measurement, 1 ms apart.
const WAKES: usize = 1000;

/// Statistics of the wake-up lateness of a process.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct WakeUp {
    /// Scheduling policy: `ordinary` or `SCHED_FIFO 80`.
    pub scheduling: String,
    /// Number of wakes.
    pub wakes: usize,
    /// Medians and tails of the lateness, us.
    pub p50_us: f64,
    pub p99_us: f64,
    pub p999_us: f64,
    pub max_us: f64,
    /// Wake-ups that came at least a whole period late.
    pub missed: usize,
}

/// Measures as an ordinary thread, and under SCHED_FIFO where that is allowed.
pub(super) fn sample() -> Result<Vec<WakeUp>, Failure> {
    let ordinary = RealtimeOptions::default();
    let fifo = RealtimeOptions { priority: Some(TRIED_PRIORITY), ..Default::default() };
    let mut samples = Vec::new();
    for (name, options) in
        [("ordinary".to_string(), ordinary), (format!("SCHED_FIFO {TRIED_PRIORITY}"), fifo)]
    {
        let lateness = std::thread::spawn(move || apply_realtime(&options).ok().map(|()| wakes()))
            .join()
            .map_err(|_| Failure::Run("the thread that samples wake-ups died".into()))?;
        if let Some(lateness) = lateness {
            samples.push(figures(name, lateness));
        }
    }
    Ok(samples)
}

/// Lateness of each wake-up, ns.
fn wakes() -> Vec<u64> {
    const PERIOD_NS: u64 = 1_000_000;
    let mut lateness = Vec::with_capacity(WAKES);
    let mut deadline = MonotonicTime(MonotonicTime::now().0 + PERIOD_NS);
    for _ in 0..WAKES {
        sleep_until(deadline, || false);
        let now = MonotonicTime::now();
        lateness.push(now.0.saturating_sub(deadline.0));
        // A wake-up that comes several periods late counts as one late wake-up.
        deadline = MonotonicTime((deadline.0 + PERIOD_NS).max(now.0));
    }
    lateness
}

fn figures(scheduling: String, mut lateness: Vec<u64>) -> WakeUp {
    lateness.sort_unstable();
    let n = lateness.len();
    let at = |q: f64| lateness[((q * n as f64).ceil() as usize).clamp(1, n) - 1] as f64 * 1e-3;
    WakeUp {
        scheduling,
        wakes: n,
        p50_us: at(0.5),
        p99_us: at(0.99),
        p999_us: at(0.999),
        max_us: at(1.0),
        missed: lateness.iter().filter(|&&ns| ns >= 1_000_000).count(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_sorted_sample() {
        let f = figures("x".into(), (1..=1000).rev().map(|i| i * 1000).collect());
        assert_eq!((f.p50_us, f.p99_us, f.p999_us, f.max_us), (500.0, 990.0, 999.0, 1000.0));
        assert_eq!((f.wakes, f.missed), (1000, 1));
    }
}
