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
use crate::model::part::Part;
use crate::model::predictor::{Likelihood, at_rest, tried, with_forces};
use crate::model::reach::Reach;

impl StateFilter {
    /// The likeliest filter of the vehicle without any cause, with or without forces. Of each decoupled part of the vehicle,
    /// whose likelihood does not depend on the others': the best with one memory for all states, improved state by state.
    /// `None` where none follows the record. When the watch is stopped, the best of those that were tried.
    pub fn likeliest(vehicle: &Vehicle, data: &Data, watch: &Watch) -> Option<Self> {
        let parts = parts(vehicle, &follow(data));
        // Both are improved before they are compared: forces of one memory may lose where those of several gain.
        let of_all = |forced: bool| {
            let found = parts
                .iter()
                .map(|part| Some(PartFilter::with_one_memory(forced, part, watch)?.improved(watch)));
            found.collect::<Option<Vec<PartFilter<'_>>>>()
        };
        let each = |all: &Vec<PartFilter<'_>>| {
            let sum = |of: fn(&Likelihood) -> f64| all.iter().map(|tried| of(&tried.likelihood)).sum::<f64>();
            sum(|found| found.bic) / sum(|found| found.rows as f64)
        };
        let tried = [false, true].into_iter().filter_map(of_all);
        let best = tried.min_by(|a, b| each(a).total_cmp(&each(b)))?;
        let forced = best.first()?.filter.forced;
        let walked = if forced { with_forces(vehicle) } else { vehicle.clone() };
        let mut memories_s = vec![data.period_s; walked.states.len()];
        for PartFilter { part, filter, .. } in best {
            let states = part.states_of_whole(vehicle, forced);
            states.into_iter().zip(filter.memories_s).for_each(|(state, own)| memories_s[state] = own);
        }
        Some(Self { forced, memories_s })
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
        let fit = model.optimum(runs.start(), None, None, Effort::Full).ok()?;
        Some(Likelihood { bic: fit.profile.bic(0), rows: fit.profile.rows })
    }
}

/// A filter of a decoupled part of a vehicle, with its likelihood.
struct PartFilter<'p> {
    part: &'p Decoupled,
    filter: StateFilter,
    likelihood: Likelihood,
}

impl<'p> PartFilter<'p> {
    /// The likeliest filter with one memory for all states.
    fn with_one_memory(forced: bool, part: &'p Decoupled, watch: &Watch) -> Option<Self> {
        let states = if forced { with_forces(&part.vehicle).states.len() } else { part.vehicle.states.len() };
        let filters = tried(&part.data).take_while(|_| !watch.is_stopped()).filter_map(|seconds| {
            let filter = StateFilter { forced, memories_s: vec![seconds; states] };
            Some(Self { likelihood: filter.likelihood(&part.vehicle, &part.data)?, filter, part })
        });
        filters.min_by(|a, b| a.likelihood.each().total_cmp(&b.likelihood.each()))
    }

    /// The filter with each state's memory changed while that makes it likelier.
    fn improved(self, watch: &Watch) -> Self {
        let Self { part, filter: mut best, likelihood: mut lowest } = self;
        let walked = best.vehicle(&part.vehicle).into_owned();
        for state in (0..walked.states.len()).filter(|state| walked.kinematic_row(*state).is_none()) {
            let own = best.memories_s[state];
            let (mut shorter, longer): (Vec<f64>, Vec<f64>) =
                tried(&part.data).filter(|seconds| *seconds != own).partition(|seconds| *seconds < own);
            shorter.reverse();
            // Outwards from the common memory, until it becomes less likely: the likelihood has one peak.
            for way in [shorter, longer] {
                for seconds in way {
                    if watch.is_stopped() {
                        return Self { part, filter: best, likelihood: lowest };
                    }
                    let mut other = best.clone();
                    other.memories_s[state] = seconds;
                    let found = other.likelihood(&part.vehicle, &part.data);
                    match found.filter(|found| found.each() < lowest.each()) {
                        Some(found) => (lowest, best) = (found, other),
                        None => break,
                    }
                }
            }
        }
        Self { part, filter: best, likelihood: lowest }
    }
}

/// A decoupled part of a vehicle, or all of it, with its part of a record.
struct Decoupled {
    /// Its states in the whole.
    states: Vec<usize>,
    vehicle: Vehicle,
    data: Data,
}

impl Decoupled {
    /// Indices in the whole of the states that a filter of the part estimates: its own, then with forces those.
    fn states_of_whole(&self, whole: &Vehicle, forced: bool) -> Vec<usize> {
        let mut all = self.states.clone();
        if forced {
            let with_dynamics = (0..whole.states.len()).filter(|i| whole.kinematic_row(*i).is_none());
            let forces = with_dynamics.zip(whole.states.len()..);
            all.extend(forces.filter(|(on, _)| self.states.contains(on)).map(|(_, force)| force));
        }
        all
    }
}

/// The decoupled parts of a vehicle that a record shows.
fn parts(vehicle: &Vehicle, data: &Data) -> Vec<Decoupled> {
    let reach = Reach::new(vehicle, data, std::iter::empty());
    let mut parts: Vec<Decoupled> = Vec::new();
    for (c, channel) in data.channels.iter().enumerate() {
        let Some(subsystem) = reach.part_around(1 << c).filter(|part| !part.inputs.is_empty()) else {
            let states = (0..vehicle.states.len()).collect();
            return vec![Decoupled { states, vehicle: vehicle.clone(), data: data.clone() }];
        };
        let is_known = |part: &Decoupled| subsystem.states == part.states;
        if subsystem.outputs.contains(&channel.output) && !parts.iter().any(is_known) {
            let part = Part::new(subsystem, vehicle, data, None);
            parts.push(Decoupled { states: part.subsystem.states, vehicle: part.vehicle, data: part.data });
        }
    }
    parts
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

    /// Axes of which one is gusty and the other quiet: the filter of both is that of each.
    #[test]
    fn decoupled_axes_have_memories_of_their_own() {
        let text = "A = [[-2.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -4.0, -1.0]]\n\
                    B = [[0.0, 5.0], [0.0, 0.0], [3.0, 0.0]]\n\
                    C = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]\n\
                    states = [{ name = \"r\" }, { name = \"phi\" }, { name = \"p\" }]\n\
                    inputs = [{ name = \"u_roll\" }, { name = \"u_yaw\" }]\n\
                    outputs = [{ name = \"roll\", noise = 0.01 }, { name = \"yaw_rate\", noise = 0.01 }, \
                    { name = \"roll_rate\", noise = 0.01 }]\n";
        let vehicle = Vehicle::parse(text, "axes.toml").unwrap();
        let input = |k: usize, j: usize| if k % (70 + 30 * j) < 35 { 0.3 } else { -0.3 };
        let mut data = flown(&vehicle, (0..3000).map(|at| input(at / 2, at % 2)).collect(), 3);
        let mut gust = 0.0;
        for (k, noise) in whirlstand_test_harness::noise(1500, 7).into_iter().enumerate() {
            gust = 0.98 * gust + 0.02 * noise;
            for channel in &mut data.channels {
                if vehicle.outputs[channel.output].name.starts_with("roll") {
                    channel.values[k] += gust;
                }
            }
        }
        let parts = parts(&vehicle, &follow(&data));
        assert_eq!(parts.len(), 2);
        let whole = StateFilter::likeliest(&vehicle, &data, &Watch::default()).unwrap();
        let sum: f64 = parts
            .iter()
            .map(|part| {
                let own =
                    part.states_of_whole(&vehicle, whole.forced).into_iter().map(|i| whole.memories_s[i]);
                let filter = StateFilter { memories_s: own.collect(), ..whole };
                filter.likelihood(&part.vehicle, &part.data).unwrap().bic
            })
            .sum();
        let joint = whole.likelihood(&vehicle, &data).unwrap().bic;
        assert!((sum - joint).abs() < 30.0, "{sum} {joint}");
        for seconds in tried(&data) {
            let common = StateFilter { memories_s: vec![seconds; whole.memories_s.len()], ..whole };
            let other = common.likelihood(&vehicle, &data);
            assert!(other.is_none_or(|other| other.bic > joint - 30.0), "{seconds} s: {other:?}, {joint}");
        }
    }

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
