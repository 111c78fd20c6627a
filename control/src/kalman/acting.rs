//! Converts the commands in force to the acting inputs, by the trim and the static effects that a filter
//! takes from the vehicle file.

use whirlstand_vehicle::{Backlash, InputEffects, RateLimit, dead_zone};

use crate::actuation::drifted;

/// Effects on one input, with their state.
#[derive(Debug, Clone)]
pub struct Acting {
    trim: f64,
    effects: InputEffects,
    /// Relative drift of the gain per period.
    drift: f64,
    rate: Option<RateLimit>,
    play: Option<Backlash>,
}

impl Acting {
    /// The state at rest under a neutral command.
    pub fn new(effects: InputEffects, trim: f64, period_s: f64) -> Self {
        let rest = dead_zone(-trim, effects.dead_zone).max(effects.lower).min(effects.upper);
        Self {
            trim,
            effects,
            drift: effects.drift_per_s * period_s,
            rate: effects.rate_per_s.is_finite().then(|| RateLimit::new(effects.rate_per_s, period_s, rest)),
            play: (effects.backlash > 0.0).then(|| Backlash::new(effects.backlash, rest)),
        }
    }

    /// Input acting over the period that begins with step `step` of the run, relative to the trim. Must be
    /// called once for every period, in order.
    pub fn next(&mut self, u: f64, step: u64) -> f64 {
        let e = &self.effects;
        let mut acting = u * drifted(self.drift, step) - self.trim;
        if e.dead_zone > 0.0 {
            acting = dead_zone(acting, e.dead_zone);
        }
        acting = acting.max(e.lower).min(e.upper);
        if let Some(rate) = &mut self.rate {
            acting = rate.next(acting);
        }
        self.play.as_mut().map_or(acting, |play| play.next(acting))
    }
}
