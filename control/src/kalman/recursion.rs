//! Gains of a filter step by step, which depend on the model and on the pattern of measurements, not on their
//! values.

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
    /// Gains per step of the pattern; the first slot is used while no gains are stored.
    slots: Vec<Gains>,
    schedule: Schedule,
    current: usize,
    started: bool,
}

impl Recursion {
    /// Starts with the covariance `p` of the model's states.
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

    /// Advances to the step with the measurements of `mask`, and computes its gains or selects stored ones.
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
            // The pattern is broken: the covariance returns to that of the gains in use.
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

    /// Advances as [`Self::advance`] with uncertainty that differs from step to step; the gains are not
    /// stored.
    pub fn advance_uncertain(&mut self, mask: u64, pushes: &[f64], more: &[f64]) {
        if self.started {
            self.covariance.predict();
        }
        self.covariance.push(pushes);
        self.started = true;
        self.current = 0;
        self.covariance.update_beside(mask, more, &mut self.slots[0]);
    }

    /// Uses gains that were computed elsewhere, given column by column.
    pub fn take_gains(&mut self, mask: u64, states: usize, gains: &[f64]) {
        self.started = true;
        self.current = 0;
        let own = &mut self.slots[0];
        own.mask = mask;
        // The slice holds (states + outputs) * outputs numbers.
        let outputs = own.whitening.columns();
        let (gain, whitening) = gains.split_at(states * outputs);
        for (j, column) in gain.chunks_exact(states).enumerate() {
            own.gain.column_mut(j).as_flattened_mut()[..states].copy_from_slice(column);
        }
        for (j, column) in whitening.chunks_exact(outputs).enumerate() {
            own.whitening.column_mut(j).as_flattened_mut()[..outputs].copy_from_slice(column);
        }
    }

    /// The gains of the last step.
    #[inline]
    pub fn gains(&self) -> &Gains {
        &self.slots[self.current]
    }

    /// Whether the first step has been made.
    #[inline]
    pub fn started(&self) -> bool {
        self.started
    }

    /// Whether the gains have converged for good.
    pub fn settled(&self) -> bool {
        self.schedule.settled()
    }

    /// Covariance of the estimate, n x n; while stored gains are in use, it is that of the step for which
    /// they were computed.
    pub fn covariance(&self, n: usize) -> DMatrix<f64> {
        let p = if self.started { &self.gains().p } else { self.covariance.p() };
        p.to_matrix(n, n)
    }
}
