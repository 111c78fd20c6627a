//! Filters with a memory of their own for each state, with or without forces that wander.
//!
//! States are disturbed by different amounts. And in a closed loop the commands answer to a force: without its state they
//! would seem to act too little (Ljung, System Identification, 1999, 13.4; Jategaonkar, Flight Vehicle System
//! Identification, 2015, chapter 5).

use std::borrow::Cow;

use whirlstand_vehicle::Vehicle;

use crate::data::record::{Data, StateFilter};
use crate::model::fit::{Effort, Model};
use crate::model::free_run::FreeRun;
use crate::model::predictor::{Likelihood, Memory, at_rest, tried, with_forces};

impl StateFilter {
    /// The likeliest filter of the vehicle without any cause, searched for state by state from one memory for all; `None`
    /// where none follows the record.
    pub fn likeliest(vehicle: &Vehicle, data: &Data, start: &Memory) -> Option<Self> {
        let data = &Data { memory_s: Some(start.seconds), ..data.clone() };
        let found = [false, true].into_iter().filter_map(|forced| {
            let states = if forced { with_forces(vehicle).states.len() } else { vehicle.states.len() };
            let mut best = Self { forced, memories_s: vec![start.seconds; states] };
            let mut lowest = best.likelihood(vehicle, data)?.bic;
            let walked = best.vehicle(vehicle);
            for state in (0..states).filter(|state| walked.kinematic_row(*state).is_none()) {
                for seconds in tried(data).filter(|seconds| *seconds != start.seconds) {
                    let mut other = best.clone();
                    other.memories_s[state] = seconds;
                    let bic = other.likelihood(vehicle, data).map(|likelihood| likelihood.bic);
                    if let Some(bic) = bic.filter(|bic| *bic < lowest) {
                        (lowest, best) = (bic, other);
                    }
                }
            }
            Some((lowest, best))
        });
        found.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, filter)| filter)
    }

    /// The vehicle whose states the filter estimates.
    pub fn vehicle<'v>(&self, vehicle: &'v Vehicle) -> Cow<'v, Vehicle> {
        if self.forced { Cow::Owned(with_forces(vehicle)) } else { Cow::Borrowed(vehicle) }
    }

    /// Runs of the vehicle along a record that is followed, corrected by this filter; `None` where it cannot follow it.
    pub fn runs<'d>(&self, vehicle: &Vehicle, data: &'d Data) -> Option<FreeRun<'d>> {
        FreeRun::new(&self.vehicle(vehicle), data).following(&self.memories_s)
    }

    /// Gain in BIC of some inputs over the same inputs at rest; `None` where one of the two has no prediction.
    pub fn gain_of_inputs(&self, vehicle: &Vehicle, data: &Data, inputs: &[usize]) -> Option<f64> {
        let still = self.likelihood(vehicle, &at_rest(vehicle, data, inputs))?;
        Some(still.bic_gain(&self.likelihood(vehicle, data)?))
    }

    /// Likelihood of the vehicle without any cause.
    fn likelihood(&self, vehicle: &Vehicle, data: &Data) -> Option<Likelihood> {
        let runs = self.runs(vehicle, data)?;
        let model = Model { free_run: &runs, free: &[], terms: Vec::new() };
        let fit = model.optimum(vec![0.0; runs.initials()], None, None, Effort::Full).ok()?;
        Some(Likelihood { bic: fit.profile.bic(0), rows: fit.profile.rows })
    }
}
