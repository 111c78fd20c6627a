//! Which predictor a record asks for: a free run, or one that follows the record, and for how long that remembers.

use whirlstand_vehicle::Vehicle;

use crate::data::record::Data;
use crate::model::fit::Model;
use crate::model::free_run::FreeRun;
use crate::model::noise::Noise;
use crate::thresholds::{
    HORIZON_RECORD_SHARE, LEAST_HORIZON_STEPS, MEMORY_GROWTH, MEMORY_RECORD_SHARE, SHORTEST_MEMORY_STEPS,
};
use crate::vehicle_poles::time_constants_s;

/// A predictor that follows the record, and what the vehicle without any cause comes to with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Memory {
    /// For how long it remembers, s.
    pub seconds: f64,
    /// Likelihood of the record, the memory counted as a number that was chosen.
    pub likelihood: Likelihood,
}

/// How likely a model makes a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likelihood {
    /// Bayesian information criterion; smaller is better.
    pub bic: f64,
    /// Samples that counted.
    pub rows: usize,
}

impl Likelihood {
    /// What another model gains in BIC. Of two that set other samples aside, each counts by the sample.
    pub fn bic_gain(&self, other: &Self) -> f64 {
        let each = |l: &Self| l.bic / l.rows.max(1) as f64;
        (each(self) - each(other)) * self.rows.min(other.rows) as f64
    }
}

/// All predictors that follow the record, the likeliest first; none where nothing can follow it.
pub fn memories(vehicle: &Vehicle, data: &Data) -> Vec<Memory> {
    let shortest = SHORTEST_MEMORY_STEPS * data.period_s;
    let longest = MEMORY_RECORD_SHARE * data.duration_s();
    let all =
        std::iter::successors(Some(shortest), |m| Some(MEMORY_GROWTH * m)).take_while(|m| *m <= longest);
    let mut found: Vec<Memory> = all.filter_map(|seconds| null(vehicle, data, seconds)).collect();
    let each = |m: &Memory| m.likelihood.bic / m.likelihood.rows.max(1) as f64;
    found.sort_by(|a, b| each(a).total_cmp(&each(b)));
    found
}

/// The vehicle alone with a memory; `None` where nothing follows the record.
fn null(vehicle: &Vehicle, data: &Data, seconds: f64) -> Option<Memory> {
    weigh(vehicle, data, Some(seconds), None).map(|likelihood| Memory { seconds, likelihood })
}

/// The vehicle alone with a memory, or none for a free run, beside a noise that is given, or fitted; `None` where that has no
/// prediction.
fn weigh(vehicle: &Vehicle, data: &Data, memory_s: Option<f64>, noise: Option<&Noise>) -> Option<Likelihood> {
    let data = Data { memory_s, ..data.clone() };
    let free_run = FreeRun::new(vehicle, &data);
    let model = Model { free_run: &free_run, free: &[], terms: Vec::new() };
    let start = vec![0.0; free_run.initials()];
    let fit = model.fit(start, noise, None).ok()?;
    Some(Likelihood { bic: fit.profile.bic(usize::from(memory_s.is_some())), rows: fit.profile.rows })
}

/// What some inputs gain in BIC over the same inputs at rest, in the data's own memory; `None` where one of the two has no
/// prediction.
pub fn gain_of_inputs(vehicle: &Vehicle, data: &Data, inputs: &[usize]) -> Option<f64> {
    gain_beside(vehicle, data, inputs, None)
}

/// The same beside white noise as it is declared, which takes no slow answer for colour; `None` also where a channel's is not.
pub fn gain_beside_declared(vehicle: &Vehicle, data: &Data, inputs: &[usize]) -> Option<f64> {
    let declared: Vec<f64> = data.channels.iter().map(|c| c.declared).collect();
    if declared.contains(&0.0) {
        return None;
    }
    gain_beside(vehicle, data, inputs, Some(&Noise::white(&declared)))
}

fn gain_beside(vehicle: &Vehicle, data: &Data, inputs: &[usize], noise: Option<&Noise>) -> Option<f64> {
    let mut still = data.clone();
    for row in still.inputs.chunks_exact_mut(data.m) {
        inputs.iter().for_each(|j| row[*j] = vehicle.inputs[*j].neutral());
    }
    let likelihood = |data: &Data| weigh(vehicle, data, data.memory_s, noise);
    Some(likelihood(&still)?.bic_gain(&likelihood(data)?))
}

/// How far ahead predictions of a vehicle are judged where nobody says, s: its slowest time constant that a record of this
/// length can show, since a prediction is then all but its own motion; where a filter follows the record, no further than that
/// remembers, since what lies beyond is up to forces that nobody knows yet.
pub fn default_horizon_s(vehicle: &Vehicle, data: &Data, memory_s: Option<f64>) -> f64 {
    let longest = HORIZON_RECORD_SHARE * data.duration_s();
    let least = LEAST_HORIZON_STEPS * data.period_s;
    let constants = time_constants_s(vehicle).into_iter().filter(|t| *t <= longest);
    let horizon_s = constants.fold(least, f64::max);
    memory_s.map_or(horizon_s, |memory_s| memory_s.clamp(least, horizon_s))
}
