//! Limits and rate limits of outputs, applied last before the wire.

use std::time::Duration;

/// Longest time between two outputs that counts for a rate limit: after a pause an output must not jump.
const LONGEST_STEP: Duration = Duration::from_millis(100);

/// Limits of value and rate of one output.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutputLimit {
    /// Value without a command.
    pub neutral: f64,
    /// Smallest value.
    pub lower: f64,
    /// Largest value.
    pub upper: f64,
    /// Largest change per second; infinite for none.
    pub rate_per_s: f64,
}

impl OutputLimit {
    /// Longest time from any value to neutral, s.
    pub fn return_s(&self) -> f64 {
        (self.upper - self.neutral).max(self.neutral - self.lower) / self.rate_per_s
    }
}

/// Keeps outputs within their limits and rates for any input. A value that is not finite is replaced by
/// neutral.
#[derive(Debug, Clone)]
pub struct Limiter {
    limits: Vec<OutputLimit>,
    last: Vec<f64>,
    at: Option<Duration>,
    clamped: u64,
    not_finite: u64,
}

impl Limiter {
    /// Outputs at neutral.
    pub fn new(limits: Vec<OutputLimit>) -> Self {
        let last = limits.iter().map(|l| l.neutral).collect();
        Self { limits, last, at: None, clamped: 0, not_finite: 0 }
    }

    /// The limited outputs for `wanted`; `None` means neutral. A value that is missing or not finite is
    /// replaced by neutral.
    pub fn apply(&mut self, wanted: Option<&[f64]>, now: Duration) -> &[f64] {
        let step = self.at.map_or(Duration::ZERO, |at| now.saturating_sub(at)).min(LONGEST_STEP);
        self.at = Some(now);
        for (i, (limit, last)) in self.limits.iter().zip(&mut self.last).enumerate() {
            let asked = match wanted {
                None => limit.neutral,
                Some(values) => match values.get(i).copied() {
                    Some(value) if value.is_finite() => value,
                    _ => {
                        self.not_finite += 1;
                        limit.neutral
                    }
                },
            };
            let within = asked.max(limit.lower).min(limit.upper);
            let reach = limit.rate_per_s * step.as_secs_f64();
            // An infinite rate times zero time is NaN, and must not hold the output.
            let moved = if reach.is_nan() { within } else { within.max(*last - reach).min(*last + reach) };
            self.clamped += u64::from(moved != asked);
            *last = moved;
        }
        &self.last
    }

    /// The last outputs.
    pub fn last(&self) -> &[f64] {
        &self.last
    }

    /// Resets to neutral without a rate limit: for an output that was handed over meanwhile.
    pub fn reset(&mut self) {
        for (limit, last) in self.limits.iter().zip(&mut self.last) {
            *last = limit.neutral;
        }
        self.at = None;
    }

    /// Number of values held by a limit or a rate.
    pub fn clamped(&self) -> u64 {
        self.clamped
    }

    /// Number of values that were not finite, or missing.
    pub fn not_finite(&self) -> u64 {
        self.not_finite
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMIT: OutputLimit =
        OutputLimit { neutral: 1500.0, lower: 1100.0, upper: 1800.0, rate_per_s: 1000.0 };

    #[test]
    fn the_way_to_neutral_takes_the_time_that_is_stated() {
        let mut limiter = Limiter::new(vec![LIMIT]);
        let mut now = Duration::ZERO;
        for _ in 0..1000 {
            now += Duration::from_millis(5);
            limiter.apply(Some(&[2500.0]), now);
        }
        assert_eq!(limiter.last(), [1800.0]);
        let end = now + Duration::from_secs_f64(LIMIT.return_s());
        while now < end {
            now += Duration::from_millis(5);
            limiter.apply(None, now);
        }
        assert_eq!(limiter.last(), [1500.0]);
    }

    proptest! {
        #[test]
        fn no_wish_passes_the_limits_or_the_rate(
            wishes in prop::collection::vec((prop::option::of(any::<f64>()), 0u64..50_000), 1..200),
            infinite in any::<bool>(),
        ) {
            let rate_per_s = if infinite { f64::INFINITY } else { LIMIT.rate_per_s };
            let mut limiter = Limiter::new(vec![OutputLimit { rate_per_s, ..LIMIT }]);
            let (mut now, mut before) = (Duration::ZERO, LIMIT.neutral);
            limiter.apply(None, now);
            for (wish, us) in wishes {
                now += Duration::from_micros(us);
                let wanted = wish.map(|w| [w]);
                let out = limiter.apply(wanted.as_ref().map(|w| w.as_slice()), now)[0];
                prop_assert!((LIMIT.lower..=LIMIT.upper).contains(&out));
                prop_assert!((out - before).abs() <= rate_per_s * us as f64 * 1e-6 + 1e-9 || infinite);
                if wish.is_none_or(|w| !w.is_finite()) && infinite {
                    prop_assert_eq!(out, LIMIT.neutral);
                }
                before = out;
            }
        }
    }
}
