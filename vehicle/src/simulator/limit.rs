//! Limits of an input, which belong to the vehicle: no command exceeds them.

use super::inputs::RateLimit;
use crate::model::Input;

/// The limits of one input, with the position of its rate limit.
#[derive(Debug, Clone)]
pub struct Limit {
    pub(super) lower: f64,
    pub(super) upper: f64,
    neutral: f64,
    pub(super) rate: Option<RateLimit>,
}

impl Limit {
    /// The limits of `input`, whose rate limit begins at `resting`.
    pub fn new(input: &Input, period_s: f64, resting: f64) -> Self {
        let rate = input.rate_limit;
        let rate = rate.is_finite().then(|| RateLimit::new(rate, period_s, resting));
        Self { lower: input.lower, upper: input.upper, neutral: input.neutral(), rate }
    }

    /// Begins at the command that was held before a record, or at the neutral value where it is unknown or not finite;
    /// returns that value within the limits.
    pub fn rest_at(&mut self, command: Option<&f64>) -> f64 {
        let known = command.filter(|u| u.is_finite());
        let held = known.map_or(self.neutral, |u| u.clamp(self.lower, self.upper));
        if let Some(rate) = &mut self.rate {
            rate.begin_at(held);
        }
        held
    }

    /// The command within the limits; `before` is the last one, which replaces NaN.
    #[inline(always)]
    pub fn next(&mut self, u: f64, before: f64) -> f64 {
        let wanted = if u.is_nan() { before } else { u.max(self.lower).min(self.upper) };
        match &mut self.rate {
            None => wanted,
            Some(rate) => rate.next(wanted),
        }
    }
}
