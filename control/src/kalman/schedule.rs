//! Schedule of the gains: decides when they are computed and when stored ones are reused.
//!
//! A filter with a periodic pattern of measurements has gains that hardly change from one repetition to the
//! next. Once a pattern is recognised, the full recursion runs over one repetition, and its gains are stored
//! and reused for as many repetitions as change the covariance by a few percent at most; then
//! [`Flow`](super::flow::Flow) computes the new covariance, and new gains follow. The longer the filter runs,
//! the longer gains are reused, finally for good. Gains with a relative error e increase the variance only by
//! a relative e^2, since it is stationary at the optimal gain.

use super::covariance::Covariance;
use super::flow::Flow;
use crate::kernel::Packed;

/// Longest recognised pattern of measurements, steps.
pub const MAX_PERIOD: usize = 64;

/// Largest change of the covariance, relative to its standard deviations, over which stored gains are reused.
const KEPT: f64 = 0.04;

/// Change of the covariance from one computation to the next below which the gains count as converged.
const SETTLED: f64 = 1e-6;

/// Largest number of repetitions between two computations; a larger one would save nothing.
const LONGEST: u64 = 1024;

/// Stage of the schedule.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// No pattern is recognised: full recursion in every step.
    Looking,
    /// A pattern of `period` steps, whose map is being composed.
    Composing { period: usize, done: usize },
    /// Full recursion over one repetition, whose gains are stored.
    Computing { period: usize, done: usize },
    /// Reuse of the stored gains, next those of step `next` of the pattern, for `left` more repetitions.
    Keeping { period: usize, next: usize, left: u64 },
}

/// What to do in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    /// Full recursion; store the gains in this slot.
    Compute(usize),
    /// Use the gains in this slot.
    Keep(usize),
}

/// Recognises patterns and decides when gains are computed.
#[derive(Debug, Clone)]
pub struct Schedule {
    recent: [u64; 2 * MAX_PERIOD],
    count: usize,
    stage: Stage,
    /// Covariance at the start of the current repetitions, and (`span`) the number of repetitions of the map.
    anchor: Packed,
    span: u64,
    settled: bool,
}

impl Schedule {
    /// Starts without a pattern; `p` has the shape of the covariance.
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

    /// Whether the gains have converged for good.
    pub fn settled(&self) -> bool {
        self.settled && matches!(self.stage, Stage::Keeping { .. })
    }

    /// Whether stored gains are in use.
    pub fn keeping(&self) -> bool {
        matches!(self.stage, Stage::Keeping { .. })
    }

    /// Task of a step with the measurements `mask`; `due` returns the measurements for which a slot was
    /// computed.
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

    /// Records a step's measurements; a deviation ends the pattern.
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

    /// Finishes a step with stored gains; after the last repetition the covariance is updated.
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

    /// Finishes a step of the full recursion.
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
                    // No gains are stored yet: the recursion has reached the covariance at the end of the
                    // map.
                    self.decide(period, flow, covariance);
                }
            }
        }
    }

    /// Computes the covariance at the end of the map, and decides how to continue.
    fn refresh(&mut self, period: usize, flow: &mut Flow, covariance: &mut Covariance) {
        covariance.set(&self.anchor);
        covariance.flow_on(flow);
        self.decide(period, flow, covariance);
    }

    /// Decides how long the next gains are reused, from the change of the covariance over the map.
    fn decide(&mut self, period: usize, flow: &mut Flow, covariance: &Covariance) {
        let change = covariance.change_from(&self.anchor);
        self.stage = Stage::Computing { period, done: 0 };
        if change > KEPT && self.span > 1 {
            // The covariance changes faster than before; the schedule restarts.
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
