//! Choice of the predictor of a record: a free run, or a filter that follows the record with a certain
//! memory.

use whirlstand_ident::identify::forces::pushed;
use whirlstand_vehicle::Vehicle;

use crate::data::record::Data;
use crate::model::fit::{Effort, Model};
use crate::model::free_run::FreeRun;
use crate::model::noise::Noise;
use crate::thresholds::{
    HORIZON_RECORD_SHARE, LEAST_HORIZON_STEPS, MEMORY_GROWTH, MEMORY_RECORD_SHARE, SHORTEST_MEMORY_STEPS,
};

/// A predictor that follows the record, with the likelihood of the vehicle without any cause.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// Memory of the predictor, s.
    pub seconds: f64,
    /// Likelihood of the record, with the memory counted as one more parameter.
    pub likelihood: Likelihood,
}

/// Likelihood of a record under a model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likelihood {
    /// Bayesian information criterion; smaller is better.
    pub bic: f64,
    /// Number of samples that counted.
    pub rows: usize,
}

impl Likelihood {
    /// BIC per sample.
    pub fn each(&self) -> f64 {
        self.bic / self.rows.max(1) as f64
    }

    /// Gain of another model in BIC. Where the two exclude different samples, BIC per sample is compared.
    pub fn bic_gain(&self, other: &Self) -> f64 {
        (self.each() - other.each()) * self.rows.min(other.rows) as f64
    }
}

/// All predictors that follow the record, the most likely first; empty where no filter can follow it.
pub fn memories(vehicle: &Vehicle, data: &Data) -> Vec<Memory> {
    let mut found: Vec<Memory> = tried(data).filter_map(|seconds| null(vehicle, data, seconds)).collect();
    found.sort_by(|a, b| a.likelihood.each().total_cmp(&b.likelihood.each()));
    found
}

/// The vehicle alone with a memory; `None` where no filter follows the record.
fn null(vehicle: &Vehicle, data: &Data, seconds: f64) -> Option<Memory> {
    weigh(vehicle, data, Some(seconds), None).map(|likelihood| Memory { seconds, likelihood })
}

/// The memories that are tried, s.
pub fn tried(data: &Data) -> impl Iterator<Item = f64> + use<> {
    let shortest = SHORTEST_MEMORY_STEPS * data.period_s;
    let longest = MEMORY_RECORD_SHARE * data.duration_s();
    std::iter::successors(Some(shortest), |m| Some(MEMORY_GROWTH * m)).take_while(move |m| *m <= longest)
}

/// The vehicle alone with a memory, or as a free run without one, with given or fitted noise; `None` where it
/// has no prediction.
fn weigh(vehicle: &Vehicle, data: &Data, memory_s: Option<f64>, noise: Option<&Noise>) -> Option<Likelihood> {
    let data = Data { memory_s, ..data.clone() };
    let free_run = FreeRun::new(vehicle, &data);
    let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
    let fit = model.optimum(free_run.start(), noise, None, Effort::Full).ok()?;
    Some(Likelihood { bic: fit.profile.bic(usize::from(memory_s.is_some())), rows: fit.profile.rows })
}

/// Gain in BIC of some inputs over the same inputs at rest, with the data's own memory; `None` where one of
/// the two has no prediction.
pub fn gain_of_inputs(vehicle: &Vehicle, data: &Data, inputs: &[usize]) -> Option<f64> {
    gain_beside(vehicle, data, inputs, None)
}

/// Gain in BIC of some inputs over the same inputs at rest beside declared white noise, which cannot absorb a
/// slow response as coloured noise; `None` also where a channel's noise is not declared.
pub fn gain_beside_declared(vehicle: &Vehicle, data: &Data, inputs: &[usize]) -> Option<f64> {
    let declared: Vec<f64> = data.channels.iter().map(|c| c.declared).collect();
    if declared.contains(&0.0) {
        return None;
    }
    gain_beside(vehicle, data, inputs, Some(&Noise::white(&declared)))
}

fn gain_beside(vehicle: &Vehicle, data: &Data, inputs: &[usize], noise: Option<&Noise>) -> Option<f64> {
    let likelihood = |data: &Data| weigh(vehicle, data, data.memory_s, noise);
    Some(likelihood(&at_rest(vehicle, data, inputs))?.bic_gain(&likelihood(data)?))
}

/// The record with some inputs at rest.
pub fn at_rest(vehicle: &Vehicle, data: &Data, inputs: &[usize]) -> Data {
    let mut still = data.clone();
    for row in still.inputs.chunks_exact_mut(data.m) {
        inputs.iter().for_each(|j| row[*j] = vehicle.inputs[*j].neutral());
    }
    still
}

/// The vehicle with an unknown force on each state that is not an integral of another. The filter estimates
/// the force as a random walk, and predictions hold it, so that unrecorded disturbances do not hide the
/// response to commands.
pub fn with_forces(vehicle: &Vehicle) -> Vehicle {
    pushed(vehicle, (0..vehicle.states.len()).filter(|i| vehicle.kinematic_row(*i).is_none()))
}

/// Default prediction horizon, s: the vehicle's slowest time constant that a record of this length can show,
/// after which a prediction is little but the vehicle's own motion; where a filter follows the record, at
/// most its memory, since predictions beyond depend on unknown forces.
pub fn default_horizon_s(vehicle: &Vehicle, data: &Data, memory_s: Option<f64>) -> f64 {
    let longest = HORIZON_RECORD_SHARE * data.duration_s();
    let least = LEAST_HORIZON_STEPS * data.period_s;
    let constants = vehicle.time_constants_s().into_iter().filter(|t| *t <= longest);
    let horizon_s = constants.fold(least, f64::max);
    memory_s.map_or(horizon_s, |memory_s| memory_s.clamp(least, horizon_s))
}
