//! Filters with a memory of their own for each state, with or without forces that wander.
//!
//! States are disturbed by different amounts. And in a closed loop the commands answer to a force: without its state they
//! would seem to act too little (Ljung, System Identification, 1999, 13.4; Jategaonkar, Flight Vehicle System
//! Identification, 2015, chapter 5).

use std::borrow::Cow;

use whirlstand_vehicle::Vehicle;

use crate::Watch;
use crate::data::record::{Data, StateFilter};
use crate::model::fit::{Effort, Model};
use crate::model::free_run::FreeRun;
use crate::model::predictor::{Likelihood, at_rest, tried, with_forces};

impl StateFilter {
    /// The likeliest filter of the vehicle without any cause: the best with one memory for all states, improved state by
    /// state. `None` where none follows the record. When the watch is stopped, the best of those that were tried.
    pub fn likeliest(vehicle: &Vehicle, data: &Data, watch: &Watch) -> Option<Self> {
        let all = tried(data).flat_map(|seconds| [(false, seconds), (true, seconds)]);
        let filters = all.take_while(|_| !watch.is_stopped()).filter_map(|(forced, seconds)| {
            let states = if forced { with_forces(vehicle).states.len() } else { vehicle.states.len() };
            let filter = Self { forced, memories_s: vec![seconds; states] };
            Some((filter.likelihood(vehicle, data)?, filter))
        });
        let (mut lowest, mut best) = filters.min_by(|(a, _), (b, _)| a.each().total_cmp(&b.each()))?;
        let walked = best.vehicle(vehicle).into_owned();
        for state in (0..walked.states.len()).filter(|state| walked.kinematic_row(*state).is_none()) {
            let own = best.memories_s[state];
            let (mut shorter, longer): (Vec<f64>, Vec<f64>) =
                tried(data).filter(|seconds| *seconds != own).partition(|seconds| *seconds < own);
            shorter.reverse();
            // Outwards from the common memory, until it becomes less likely: the likelihood has one peak.
            for way in [shorter, longer] {
                for seconds in way {
                    if watch.is_stopped() {
                        return Some(best);
                    }
                    let mut other = best.clone();
                    other.memories_s[state] = seconds;
                    let found = other.likelihood(vehicle, data);
                    match found.filter(|found| found.each() < lowest.each()) {
                        Some(found) => (lowest, best) = (found, other),
                        None => break,
                    }
                }
            }
        }
        Some(best)
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

    /// Likelihood of the vehicle without any cause; `None` where it has no prediction.
    pub fn likelihood(&self, vehicle: &Vehicle, data: &Data) -> Option<Likelihood> {
        let data = follow(data);
        let runs = self.runs(vehicle, &data)?;
        let model = Model { free_run: &runs, free: &[], terms: Vec::new() };
        let fit = model.optimum(vec![0.0; runs.initials()], None, None, Effort::Full).ok()?;
        Some(Likelihood { bic: fit.profile.bic(0), rows: fit.profile.rows })
    }
}

/// The record as one that a filter follows; its own memory is not used.
pub fn follow(data: &Data) -> Data {
    Data { memory_s: Some(data.period_s), ..data.clone() }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::data::flown::flown;

    /// On a record of minutes it took longer than the time that the user had given.
    #[test]
    fn no_filter_is_tried_after_the_end() {
        let vehicle = Vehicle::builtin("quadrotor").unwrap();
        let data = flown(&vehicle, vec![0.1; 400], 1);
        assert!(StateFilter::likeliest(&vehicle, &data, &Watch::default()).is_some());
        let ended = Watch::default().until(Instant::now());
        assert_eq!(StateFilter::likeliest(&vehicle, &data, &ended), None);
    }
}
