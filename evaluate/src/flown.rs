//! The figures of flights that were simulated in this process, without a log, to the last bit those that their logs would give.
//!
//! Their steps are held, some hundred bytes each, because what is to be judged of a step is known only when the flight is over.
//! Flights may go side by side: each row has one number of every flight.

mod gathered;
mod step;

use whirlstand_vehicle::Vehicle;

use crate::summary::RunSummary;
use gathered::Gathered;
pub use step::{FlownStep, NodeCounts};

/// Flights side by side in [`FlownTogether`].
pub const LANES: usize = 16;

/// A flight, step by step.
// Not generic, as [`FlownTogether`]: what it does is compiled here, where it is compiled to be fast.
#[derive(Debug, Clone)]
pub struct Flown(Gathered<1>);

impl Flown {
    /// Before the first of about `steps` steps of `vehicle`.
    pub fn new(vehicle: &Vehicle, period_s: f64, steps: usize) -> Self {
        Self(Gathered::new(vehicle, period_s, steps))
    }

    /// Takes the next step.
    pub fn take(&mut self, step: &FlownStep<'_, 1>) {
        self.0.take(step);
    }

    /// The figures of the flight of `vehicle` as `name`; the consistency of the filter without the errors of the states.
    pub fn summary(&self, vehicle: &Vehicle, name: &str, seed: u64, counts: &NodeCounts) -> RunSummary {
        self.0.summary(0, (vehicle, name, seed), counts)
    }
}

/// Flights side by side, which differ in what follows from seeds, initial states and disturbances only.
#[derive(Debug, Clone)]
pub struct FlownTogether(Gathered<LANES>);

impl FlownTogether {
    /// Before the first of about `steps` steps of `vehicle`.
    pub fn new(vehicle: &Vehicle, period_s: f64, steps: usize) -> Self {
        Self(Gathered::new(vehicle, period_s, steps))
    }

    /// Takes the next step of all.
    pub fn take(&mut self, step: &FlownStep<'_, LANES>) {
        self.0.take(step);
    }

    /// As [`Flown::summary`], of the flight in lane `lane`, below [`LANES`].
    pub fn summary(
        &self,
        lane: usize,
        (vehicle, name, seed): (&Vehicle, &str, u64),
        counts: &NodeCounts,
    ) -> RunSummary {
        self.0.summary(lane, (vehicle, name, seed), counts)
    }
}
