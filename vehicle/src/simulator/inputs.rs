//! Effects on an input before the linear model: limits, static nonlinearities, delay.

use super::switch::Switch;
use crate::effects::{Effect, Kind};

/// Rate limit of a sampled signal.
///
/// Within a period the limited signal is a ramp that may end at the target. The value over the period is
/// taken as the ramp's mean, which has the ramp's integral.
#[derive(Debug, Clone)]
pub struct RateLimit {
    /// Largest change per period.
    step: f64,
    position: f64,
}

impl RateLimit {
    /// A rate limit that begins at `start`, with one target per `period_s`.
    pub fn new(limit_per_s: f64, period_s: f64, start: f64) -> Self {
        Self { step: limit_per_s * period_s, position: start }
    }

    /// Begins at another value.
    pub fn begin_at(&mut self, start: f64) {
        self.position = start;
    }

    /// Mean value over the next period for the given `target`.
    pub fn next(&mut self, target: f64) -> f64 {
        let gap = target - self.position;
        if gap.abs() > self.step {
            let from = self.position;
            self.position += self.step.copysign(gap);
            return 0.5 * (from + self.position);
        }
        self.position = target;
        if self.step == 0.0 || gap == 0.0 {
            return target;
        }
        // The ramp takes abs(gap) / step of the period, during which the signal is off by gap / 2 on average.
        target - 0.5 * gap * (gap.abs() / self.step)
    }
}

/// Backlash (play operator): the output moves only when the input pushes against one end of the gap.
#[derive(Debug, Clone)]
pub struct Backlash {
    half: f64,
    position: f64,
}

impl Backlash {
    /// A backlash of this full width, with its output at `start` and its input in the middle of the gap.
    pub fn new(width: f64, start: f64) -> Self {
        Self { half: 0.5 * width, position: start }
    }

    /// The output for the input `u`.
    pub fn next(&mut self, u: f64) -> f64 {
        self.position = self.position.max(u - self.half).min(u + self.half);
        self.position
    }
}

/// Dead zone: sign(u) max(abs(u) - width, 0).
pub fn dead_zone(u: f64, width: f64) -> f64 {
    (u.abs() - width).max(0.0).copysign(u)
}

/// One static effect between command and model.
#[derive(Debug, Clone)]
enum Link {
    Gain(f64),
    Drift(f64),
    Bias(f64),
    DeadZone(f64),
    Saturation(f64, f64),
    Rate(RateLimit),
    Backlash(Backlash),
}

/// The static effects on one input, in the simulator's order.
#[derive(Debug, Clone, Default)]
pub struct Chain(Vec<(Switch, Link)>);

/// Order in which the effects on an input act.
const ORDER: [Kind; 7] = [
    Kind::InputGain,
    Kind::GainDrift,
    Kind::InputBias,
    Kind::DeadZone,
    Kind::InputSaturation,
    Kind::RateLimit,
    Kind::Backlash,
];

impl Chain {
    /// The chain of `effects`, all at this input; rate limit and backlash start at `neutral`.
    pub fn new<'a>(
        effects: impl Iterator<Item = (usize, &'a Effect)> + Clone,
        neutral: f64,
        period_s: f64,
    ) -> Self {
        let mut links = Vec::new();
        for kind in ORDER {
            for (index, effect) in effects.clone().filter(|(_, e)| e.kind() == kind) {
                let link = match kind {
                    Kind::InputGain => Link::Gain(effect.get("factor")),
                    Kind::GainDrift => Link::Drift(effect.get("rate_per_s")),
                    Kind::InputBias => Link::Bias(effect.get("offset")),
                    Kind::DeadZone => Link::DeadZone(effect.get("width")),
                    Kind::InputSaturation => Link::Saturation(effect.get("lower"), effect.get("upper")),
                    Kind::RateLimit => {
                        Link::Rate(RateLimit::new(effect.get("limit_per_s"), period_s, neutral))
                    }
                    _ => Link::Backlash(Backlash::new(effect.get("width"), neutral)),
                };
                links.push((Switch::new(index, effect), link));
            }
        }
        let mut chain = Self(links);
        chain.rest_at(neutral);
        chain
    }

    /// Sets rate limits and backlashes to where they are after the command `u` was held; returns the signal there.
    pub fn rest_at(&mut self, u: f64) -> f64 {
        self.0.iter_mut().fold(u, |u, (switch, link)| {
            match link {
                Link::Rate(limit) => limit.begin_at(u),
                Link::Backlash(play) => play.position = u,
                _ => {}
            }
            link.next_if(switch, u, 0.0)
        })
    }

    /// The chain of an input, and its delay, in which the chain's output at `neutral` is held.
    pub fn with_delay<'a>(
        effects: impl Iterator<Item = (usize, &'a Effect)> + Clone,
        neutral: f64,
        period_s: f64,
    ) -> (Self, Delay) {
        let mut chain = Self::new(effects.clone(), neutral, period_s);
        let delays = effects.filter(|(_, e)| e.kind() == Kind::InputDelay);
        let longest_s = delays.map(|(_, e)| e.get("delay_s")).sum();
        let rest = chain.rest_at(neutral);
        (chain, Delay::new(longest_s, period_s, rest))
    }

    /// True for kinds of effects that are links of a chain.
    pub fn holds(kind: Kind) -> bool {
        ORDER.contains(&kind)
    }

    /// True when the signal is unchanged.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The signal after all effects, for command `u` at time `t`.
    pub fn next(&mut self, u: f64, t: f64) -> f64 {
        self.0.iter_mut().fold(u, |u, (switch, link)| link.next_if(switch, u, t))
    }

    /// Switches an effect; true if it is one of these.
    pub fn switch(&mut self, effect: usize, on: bool) -> bool {
        self.0.iter_mut().any(|(switch, _)| switch.set(effect, on))
    }

    /// Sets the position of a rate limit or backlash; true if the effect is one.
    pub fn put(&mut self, effect: usize, position: f64) -> bool {
        let own = self.0.iter_mut().find(|(switch, _)| switch.is_of(effect));
        match own.map(|(_, link)| link) {
            Some(Link::Rate(limit)) => limit.position = position,
            Some(Link::Backlash(play)) => play.position = position,
            _ => return false,
        }
        true
    }
}

impl Link {
    /// The next value as [`Self::next`] while the effect acts; otherwise the signal is unchanged, and effects
    /// with memory follow it.
    fn next_if(&mut self, switch: &Switch, u: f64, t: f64) -> f64 {
        if switch.is_on(t) {
            return self.next(u, switch.since(t));
        }
        match self {
            Self::Rate(limit) => limit.position = u,
            Self::Backlash(play) => play.position = u,
            _ => {}
        }
        u
    }

    fn next(&mut self, u: f64, t: f64) -> f64 {
        match self {
            Self::Gain(factor) => *factor * u,
            Self::Drift(rate) => u * (1.0 + *rate * t),
            Self::Bias(offset) => u + *offset,
            Self::DeadZone(width) => dead_zone(u, *width),
            Self::Saturation(lower, upper) => u.max(*lower).min(*upper),
            Self::Rate(limit) => limit.next(u),
            Self::Backlash(play) => play.next(u),
        }
    }
}

/// Delay of a sampled-and-held signal by any time, whole periods and a fraction.
#[derive(Debug, Clone)]
pub struct Delay {
    /// Offset in the period at which the signal changes, s.
    pub fraction_s: f64,
    whole: usize,
    ring: Vec<f64>,
    newest: usize,
}

impl Delay {
    /// A delay of up to `longest_s`, which applies until another is chosen.
    pub fn new(longest_s: f64, period_s: f64, rest: f64) -> Self {
        let (whole, fraction_s) = split(longest_s, period_s);
        // Bounded by the table: 60 s.
        let whole = whole as usize;
        Self { fraction_s, whole, ring: vec![rest; whole + 2], newest: 0 }
    }

    /// Holds a value that was there for longer than the delay.
    pub fn rest_at(&mut self, value: f64) {
        self.ring.fill(value);
    }

    /// Sets another delay, whole periods and a remainder in s, at most the longest.
    pub fn choose(&mut self, (whole, fraction_s): (u64, f64)) {
        (self.whole, self.fraction_s) = ((whole as usize).min(self.ring.len() - 2), fraction_s);
    }

    /// True when a pushed value acts immediately.
    pub fn is_none(&self) -> bool {
        self.fraction_s == 0.0 && self.ring.len() == 2
    }

    /// Whole periods of the delay.
    pub fn whole_steps(&self) -> usize {
        self.whole
    }

    /// Stores the value of this period.
    pub fn push(&mut self, value: f64) {
        self.newest = if self.newest + 1 == self.ring.len() { 0 } else { self.newest + 1 };
        self.ring[self.newest] = value;
    }

    /// Value that acts at the beginning of the period.
    #[inline(always)]
    pub fn first(&self) -> f64 {
        if self.fraction_s > 0.0 { self.older() } else { self.newer() }
    }

    /// Value that acts from `fraction_s` on.
    pub fn newer(&self) -> f64 {
        self.before_newest(self.whole)
    }

    /// Value that acts before `fraction_s`.
    pub fn older(&self) -> f64 {
        self.before_newest(self.whole + 1)
    }

    fn before_newest(&self, by: usize) -> f64 {
        let at = if by <= self.newest { self.newest - by } else { self.newest + self.ring.len() - by };
        self.ring[at]
    }
}

/// Fraction of a period below which a time difference is rounding.
pub const TIME_TOLERANCE: f64 = 1e-9;

/// Splits a time into whole periods and a remainder, which is 0 where only rounding makes it non-zero.
pub fn split(time_s: f64, period_s: f64) -> (u64, f64) {
    let periods = (time_s / period_s + TIME_TOLERANCE).floor().max(0.0);
    let rest = time_s - periods * period_s;
    let rest = if rest <= TIME_TOLERANCE * period_s { 0.0 } else { rest };
    (periods as u64, rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dead_zone_is_its_definition() {
        for (u, expected) in [(0.5, 0.3), (-0.5, -0.3), (0.1, 0.0), (-0.2, 0.0)] {
            assert!((dead_zone(u, 0.2) - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn backlash_closes_a_loop_of_its_width() {
        let mut play = Backlash::new(0.4, 0.0);
        let path = [0.1, 0.5, 1.0, 0.8, 0.5, -1.0, -0.7, 0.0];
        let expected = [0.0, 0.3, 0.8, 0.8, 0.7, -0.8, -0.8, -0.2];
        for (u, y) in path.into_iter().zip(expected) {
            assert!((play.next(u) - y).abs() < 1e-15, "{u}");
        }
    }

    #[test]
    fn rate_limit_keeps_the_ramps_integral() {
        // To 1 at 4 per second in periods of 0.1: the integral over 0.5 s is 0.5 - 1/8.
        let mut limit = RateLimit::new(4.0, 0.1, 0.0);
        let sum: f64 = (0..5).map(|_| 0.1 * limit.next(1.0)).sum();
        assert!((sum - 0.375).abs() < 1e-15);
        // It never exceeds the rate limit, and stops at the target.
        assert_eq!(limit.next(1.0), 1.0);
        let mut held = RateLimit::new(0.0, 0.1, 0.3);
        assert_eq!(held.next(5.0), 0.3);
        assert_eq!(held.next(0.3), 0.3);
    }

    #[test]
    fn delay_returns_what_was_pushed_so_many_periods_ago() {
        for whole in 0..5 {
            let mut delay = Delay::new(f64::from(whole) * 0.1 + 0.03, 0.1, -1.0);
            assert!((delay.fraction_s - 0.03).abs() < 1e-15);
            for k in 0..20 {
                delay.push(f64::from(k));
                let at = |k: i32| if k < 0 { -1.0 } else { f64::from(k) };
                assert_eq!(delay.newer(), at(k - whole));
                assert_eq!(delay.older(), at(k - whole - 1));
            }
        }
        assert_eq!(Delay::new(0.3, 0.1, 0.0).fraction_s, 0.0);
    }

    #[test]
    fn another_delay_is_taken_out_of_what_is_remembered() {
        let mut delay = Delay::new(0.4, 0.1, 0.0);
        (1..10).for_each(|k| delay.push(f64::from(k)));
        for (whole, newer) in [(4, 5.0), (0, 9.0), (2, 7.0)] {
            delay.choose((whole, 0.0));
            assert_eq!((delay.newer(), delay.older()), (newer, newer - 1.0));
        }
    }

    #[test]
    fn chain_acts_in_its_own_order() {
        let effect = |kind, parameters: &[(&str, f64)]| Effect::new(kind, "u", parameters).unwrap();
        let effects = [
            effect(Kind::InputSaturation, &[("lower", -1.0), ("upper", 1.0)]),
            effect(Kind::DeadZone, &[("width", 0.1)]),
            effect(Kind::InputBias, &[("offset", 0.2)]),
            effect(Kind::GainDrift, &[("rate_per_s", -0.01)]),
            effect(Kind::InputGain, &[("factor", 0.5)]),
        ];
        let mut chain = Chain::new(effects.iter().enumerate(), 0.0, 0.01);
        let expected = 0.5 * 0.9 * 1.2 + 0.2 - 0.1;
        assert!((chain.next(1.2, 10.0) - expected).abs() < 1e-15);
        assert_eq!(chain.next(100.0, 10.0), 1.0);
    }
}
