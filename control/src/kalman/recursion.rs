//! The gains of a filter, step by step: they follow from the model and from which measurements come, not from their values.

use nalgebra::DMatrix;

use super::covariance::{Covariance, Gains};
use super::filter_model::FilterModel;
use super::flow::Flow;
use super::schedule::{MAX_PERIOD, Schedule, Task};

/// Covariance and gains of a filter.
#[derive(Debug, Clone)]
pub struct Recursion {
    covariance: Covariance,
    flow: Flow,
    /// Per step of the pattern; the first serves while nothing is kept.
    slots: Vec<Gains>,
    schedule: Schedule,
    current: usize,
    started: bool,
}

impl Recursion {
    /// Begins with the covariance `p` of the model's states.
    pub fn new(model: &FilterModel, p: &DMatrix<f64>) -> Self {
        let covariance = Covariance::new(model, p);
        Self {
            schedule: Schedule::new(covariance.p()),
            covariance,
            flow: Flow::new(model),
            slots: vec![Gains::none(p, model.h.nrows()); MAX_PERIOD],
            current: 0,
            started: false,
        }
    }

    /// Goes on to the step in which the measurements of `mask` come; the gains are then those of it.
    #[inline]
    pub fn advance(&mut self, mask: u64) {
        let keeping = self.schedule.keeping();
        match self.schedule.task(mask, |slot| self.slots[slot].mask) {
            Task::Keep(slot) => {
                self.current = slot;
                self.schedule.kept(&mut self.flow, &mut self.covariance);
            }
            Task::Compute(slot) => self.compute(slot, mask, keeping),
        }
    }

    fn compute(&mut self, slot: usize, mask: u64, keeping: bool) {
        if keeping {
            // The pattern has broken: back to where the gains in use came from.
            self.covariance.set(&self.slots[self.current].p);
        }
        if self.started {
            self.covariance.predict();
        }
        self.started = true;
        self.current = slot;
        self.covariance.update(mask, &mut self.slots[slot]);
        self.schedule.computed(mask, &mut self.flow, &mut self.covariance);
    }

    /// The gains of the last step.
    #[inline]
    pub fn gains(&self) -> &Gains {
        &self.slots[self.current]
    }

    /// Whether there has been a step.
    #[inline]
    pub fn started(&self) -> bool {
        self.started
    }

    /// Whether the gains have settled for good.
    pub fn settled(&self) -> bool {
        self.schedule.settled()
    }

    /// Covariance of the estimate, n x n; while gains are kept, that of the step they were computed for.
    pub fn covariance(&self, n: usize) -> DMatrix<f64> {
        let p = if self.started { &self.gains().p } else { self.covariance.p() };
        p.to_matrix(n, n)
    }
}
