//! Round trips at a steady pace, and their durations.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;

use super::{BenchError, Figure};
use crate::os::{MonotonicTime, sleep_until};

/// Period of the round trips: that of the measured loop.
pub(super) const PERIOD: Duration = Duration::from_millis(2);

/// Number of round trips for warm-up.
const WARM_UP: u32 = 100;

/// Largest ratio of a bridge's latency to that of the bare echo.
const GOAL: f64 = 2.0;

/// One round trip: sends, and waits for the answer. The argument is its number.
pub(super) type Exchange<'a> = dyn FnMut(u32) -> Result<(), BenchError> + 'a;

/// Distribution of the durations of round trips.
pub(super) struct RoundTrips(Histogram<u64>);

impl RoundTrips {
    /// Makes round trips for the given time, s.
    pub(super) fn take(seconds: f64, exchange: &mut Exchange<'_>) -> Result<Self, BenchError> {
        let mut times = Histogram::new_with_bounds(1, 60_000_000_000, 3)
            .map_err(|e| BenchError::Member { who: "the histogram".into(), why: e.to_string() })?;
        let count = (seconds / PERIOD.as_secs_f64()).ceil().max(1.0) as u32;
        let mut due = MonotonicTime::now();
        for i in 0..count.saturating_add(WARM_UP) {
            sleep_until(due, || false);
            let start = Instant::now();
            // After a late one the schedule is shifted instead of catching up.
            due = MonotonicTime(MonotonicTime::now().0 + PERIOD.as_nanos() as u64);
            exchange(i)?;
            if i >= WARM_UP {
                times.saturating_record(start.elapsed().as_nanos() as u64);
            }
        }
        Ok(Self(times))
    }

    /// The 50 % and 99 % quantiles and the maximum; the goal for the median of a bridge follows from the
    /// `echo`.
    pub(super) fn figures(&self, name: &str, echo: Option<&Self>) -> Vec<Figure> {
        let goal = echo.map(|echo| GOAL * echo.us(0.5));
        [("p50", 0.5, goal), ("p99", 0.99, None), ("max", 1.0, None)]
            .map(|(word, q, goal)| Figure::lowest(format!("{name}, {word}"), "us", vec![self.us(q)], goal))
            .into()
    }

    fn us(&self, quantile: f64) -> f64 {
        self.0.value_at_quantile(quantile) as f64 * 1e-3
    }
}
