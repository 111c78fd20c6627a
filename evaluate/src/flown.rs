//! Figures of flights that were simulated in this process without a log. They are bit for bit those that their
//! logs would give.
//!
//! All steps are stored, some hundred bytes each, because which parts of a step are evaluated is known only at the
//! end of the flight. Flights may be computed side by side: each row then has one number of every flight.

mod gathered;
mod step;

use whirlstand_vehicle::Vehicle;

use crate::summary::RunSummary;
use gathered::Gathered;
pub use step::{FlownStep, NodeCounts};

/// Number of flights side by side in [`FlownTogether`].
pub const LANES: usize = 16;

/// A flight, step by step.
// Not generic, like [`FlownTogether`], so that the code is compiled in this crate, with its optimisation.
#[derive(Debug, Clone)]
pub struct Flown(Gathered<1>);

impl Flown {
    /// Without steps so far; `steps` is the approximate number of steps of `vehicle`.
    pub fn new(vehicle: &Vehicle, period_s: f64, steps: usize) -> Self {
        Self(Gathered::new(vehicle, period_s, steps))
    }

    /// Appends the next step.
    pub fn take(&mut self, step: &FlownStep<'_, 1>) {
        self.0.take(step);
    }

    /// The figures of the flight of `vehicle` under `name`; the consistency of the filter is without the errors of
    /// the states.
    pub fn summary(&self, vehicle: &Vehicle, name: &str, seed: u64, counts: &NodeCounts) -> RunSummary {
        self.0.summary(0, (vehicle, name, seed), counts)
    }
}

/// Flights side by side. They differ only in data that depend on seeds, initial states and disturbances.
#[derive(Debug, Clone)]
pub struct FlownTogether(Gathered<LANES>);

impl FlownTogether {
    /// Without steps so far; `steps` is the approximate number of steps of `vehicle`.
    pub fn new(vehicle: &Vehicle, period_s: f64, steps: usize) -> Self {
        Self(Gathered::new(vehicle, period_s, steps))
    }

    /// Appends the next step of all flights.
    pub fn take(&mut self, step: &FlownStep<'_, LANES>) {
        self.0.take(step);
    }

    /// As [`Flown::summary`], for the flight in lane `lane`, which is below [`LANES`].
    pub fn summary(
        &self,
        lane: usize,
        (vehicle, name, seed): (&Vehicle, &str, u64),
        counts: &NodeCounts,
    ) -> RunSummary {
        self.0.summary(lane, (vehicle, name, seed), counts)
    }
}
