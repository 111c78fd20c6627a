//! When gains are computed and when they are kept.
//!
//! A filter whose measurements come in a repeating pattern has gains that hardly change from one repetition to the
//! next. Once a pattern is recognised, the covariance is taken over it by the full recursion, whose gains are then
//! kept for as many repetitions as change it by a few percent at most; then [`Flow`](super::flow::Flow) tells what
//! it has become, and the next gains are computed. The longer the filter runs the longer they are kept, in the end
//! for good. Gains that are wrong by a part e raise the variance by e^2 only, as they are at its minimum.

use super::covariance::Covariance;
use super::flow::Flow;
use crate::kernel::Packed;

/// Longest pattern of measurements, in steps, that is recognised.
pub const MAX_PERIOD: usize = 64;

/// Largest change of the covariance, relative to its standard deviations, over which gains are kept.
const KEPT: f64 = 0.04;

/// Change of the covariance from one computation to the next below which gains count as settled.
const SETTLED: f64 = 1e-6;

/// Most repetitions from one computation to the next: beyond these nothing is saved by keeping longer.
const LONGEST: u64 = 1024;

/// Where the filter stands.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// No pattern yet: the full recursion in every step.
    Looking,
    /// A pattern of that many steps, whose map is being put together.
    Composing { period: usize, done: usize },
    /// The full recursion over one repetition; its gains will be kept.
    Computing { period: usize, done: usize },
    /// The gains of step `next` of the pattern are due, for `left` more repetitions.
    Keeping { period: usize, next: usize, left: u64 },
}

/// What one step has to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    /// The full recursion, gains into this slot.
    Compute(usize),
    /// The gains in this slot serve.
    Keep(usize),
}

/// Recognises patterns and decides.
#[derive(Debug, Clone)]
pub struct Schedule {
    recent: [u64; 2 * MAX_PERIOD],
    count: usize,
    stage: Stage,
    /// The covariance at the beginning of the present repetitions, and how many the map is over.
    anchor: Packed,
    span: u64,
    settled: bool,
}

impl Schedule {
    /// Nothing recognised; `p` has the shape of the covariance.
    pub fn new(p: &Packed) -> Self {
        Self {
            recent: [0; 2 * MAX_PERIOD],
            count: 0,
            stage: Stage::Looking,
            anchor: p.clone(),
            span: 1,
            settled: false,
        }
    }

    /// Whether the gains have settled for good.
    pub fn settled(&self) -> bool {
        self.settled && matches!(self.stage, Stage::Keeping { .. })
    }

    /// Whether kept gains are in use.
    pub fn keeping(&self) -> bool {
        matches!(self.stage, Stage::Keeping { .. })
    }

    /// What a step with these measurements has to do; `due` are those that the slot was computed for.
    #[inline]
    pub fn task(&mut self, mask: u64, due: impl Fn(usize) -> u64) -> Task {
        if let Stage::Keeping { next, .. } = self.stage {
            if due(next) == mask {
                return Task::Keep(next);
            }
            self.forget();
        }
        self.notice(mask);
        match self.stage {
            Stage::Computing { done, .. } => Task::Compute(done),
            _ => Task::Compute(0),
        }
    }

    fn forget(&mut self) {
        self.stage = Stage::Looking;
        self.count = 0;
        self.settled = false;
    }

    /// Takes note of a step's measurements; what breaks the pattern ends it.
    fn notice(&mut self, mask: u64) {
        self.recent[self.count % (2 * MAX_PERIOD)] = mask;
        self.count += 1;
        let ago = |k: usize| self.recent[(self.count - 1 - k) % (2 * MAX_PERIOD)];
        match self.stage {
            Stage::Composing { period, .. } | Stage::Computing { period, .. } if ago(0) != ago(period) => {
                self.stage = Stage::Looking;
                self.settled = false;
            }
            _ => {}
        }
        if self.stage == Stage::Looking && self.count >= 2 * MAX_PERIOD && self.count.is_multiple_of(16) {
            let period = (1..=MAX_PERIOD).find(|&p| (0..2 * MAX_PERIOD - p).all(|k| ago(k) == ago(k + p)));
            if let Some(period) = period {
                self.stage = Stage::Composing { period, done: 0 };
            }
        }
    }

    /// Ends a step that kept its gains; at the end of the repetitions the covariance is brought up to date.
    #[inline]
    pub fn kept(&mut self, flow: &mut Flow, covariance: &mut Covariance) {
        let Stage::Keeping { period, next, left } = &mut self.stage else { return };
        *next += 1;
        if *next < *period {
            return;
        }
        *next = 0;
        if self.settled {
            return;
        }
        *left -= 1;
        if *left == 0 {
            let period = *period;
            self.refresh(period, flow, covariance);
        }
    }

    /// Ends a step of the full recursion.
    pub fn computed(&mut self, mask: u64, flow: &mut Flow, covariance: &mut Covariance) {
        match &mut self.stage {
            Stage::Looking | Stage::Keeping { .. } => {}
            Stage::Composing { period, done } => {
                let period = *period;
                if *done == 0 {
                    flow.clear();
                }
                flow.append(mask);
                *done += 1;
                if *done == period {
                    self.span = 1;
                    self.anchor.copy_from(covariance.p());
                    self.stage = Stage::Computing { period, done: 0 };
                }
            }
            Stage::Computing { period, done } => {
                *done += 1;
                if *done < *period {
                    return;
                }
                let period = *period;
                if self.span > 1 || self.settled {
                    self.stage = Stage::Keeping { period, next: 0, left: self.span - 1 };
                } else {
                    // Nothing is kept yet: what the recursion has reached is the end of the map.
                    self.decide(period, flow, covariance);
                }
            }
        }
    }

    /// The covariance at the end of the map, by the map.
    fn refresh(&mut self, period: usize, flow: &mut Flow, covariance: &mut Covariance) {
        covariance.set(&self.anchor);
        covariance.flow_on(flow);
        self.decide(period, flow, covariance);
    }

    /// From how much the covariance has changed over the map: how long the next gains will be kept.
    fn decide(&mut self, period: usize, flow: &mut Flow, covariance: &Covariance) {
        let change = covariance.change_from(&self.anchor);
        self.stage = Stage::Computing { period, done: 0 };
        if change > KEPT && self.span > 1 {
            // It moves faster than it did; begin anew.
            self.stage = Stage::Composing { period, done: 0 };
        } else if change <= SETTLED {
            self.settled = true;
        } else if change <= 0.5 * KEPT && self.span < LONGEST {
            flow.double();
            self.span *= 2;
        }
        self.anchor.copy_from(covariance.p());
    }
}
