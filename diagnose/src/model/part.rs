//! A decoupled part of a vehicle with its part of a record.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use whirlstand_vehicle::{Free, Subsystem, Vehicle};

use crate::candidates::library::Candidate;
use crate::data::record::{Channel, Data};
use crate::model::observer::Observer;
use crate::model::optimum::{ModelError, Optimum};
use crate::model::score_test::ScoredStart;

/// Bits of the values of all parameters from which something over a part starts, and a variant of it.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Start(Vec<u64>, u8);

impl Start {
    /// A start from these values.
    pub fn new<'v>(values: impl IntoIterator<Item = &'v f64>, variant: u8) -> Self {
        Self(values.into_iter().map(|value| value.to_bits()).collect(), variant)
    }
}

/// Results over a part of a vehicle, made once for each start, set of free parameters and list of terms: while causes are
/// added to or taken from another part, this one's stay as they are.
#[derive(Debug)]
pub struct Memo<T>(Mutex<HashMap<Start, Vec<Made<T>>>>);

#[derive(Debug)]
struct Made<T> {
    free: Vec<Free>,
    terms: Vec<Candidate>,
    result: T,
}

impl<T> Default for Memo<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T: Clone> Memo<T> {
    /// The result of an earlier call with the same arguments; else that of `make`.
    pub fn once(&self, start: Start, (free, terms): (&[Free], &[Candidate]), make: impl FnOnce() -> T) -> T {
        let all = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |known: &&Made<T>| known.free == free && known.terms == terms;
        if let Some(known) = all().get(&start).and_then(|known| known.iter().find(is_same)) {
            return known.result.clone();
        }
        let result = make();
        let made = Made { free: free.to_vec(), terms: terms.to_vec(), result: result.clone() };
        all().entry(start).or_default().push(made);
        result
    }
}

/// A decoupled part of a vehicle, and its part of a record.
#[derive(Debug)]
pub struct Part {
    /// States, inputs and outputs of the part.
    pub subsystem: Subsystem,
    /// Indices of its channels in the record.
    pub channels: Vec<usize>,
    /// The vehicle with its states, inputs and outputs only.
    pub vehicle: Vehicle,
    /// The record with its inputs and channels only.
    pub data: Data,
    /// Its part of the filter that follows the record.
    pub observer: Option<Arc<Observer>>,
    /// Its fits.
    pub fits: Memo<Result<Optimum, ModelError>>,
    /// Scores of the starts of candidates.
    pub scores: Memo<Vec<ScoredStart>>,
    /// Gains of candidates in BIC, and where their fits start.
    pub gains: Memo<(f64, Vec<f64>)>,
}

impl Part {
    /// A part of a vehicle, of a record, and of the filter that follows it.
    pub fn new(subsystem: Subsystem, vehicle: &Vehicle, data: &Data, observer: Option<&Observer>) -> Self {
        let (mut indices, mut channels) = (Vec::new(), Vec::new());
        for (c, channel) in data.channels.iter().enumerate() {
            if let Some(output) = subsystem.outputs.iter().position(|i| *i == channel.output) {
                indices.push(c);
                channels.push(Channel { output, ..channel.clone() });
            }
        }
        let inputs = data.inputs.chunks_exact(data.m);
        let data = Data {
            inputs: inputs.flat_map(|u| subsystem.inputs.iter().map(|j| u[*j])).collect(),
            m: subsystem.inputs.len(),
            channels,
            origin: data.origin.clone(),
            starts: data.starts.clone(),
            clocks: data.clocks.clone(),
            likeliest_filter: None,
            ..*data
        };
        let observer = observer.map(|whole| Arc::new(whole.of_part(&subsystem.states, &indices)));
        let vehicle = subsystem.vehicle(vehicle);
        Self {
            vehicle,
            subsystem,
            channels: indices,
            data,
            observer,
            fits: Memo::default(),
            scores: Memo::default(),
            gains: Memo::default(),
        }
    }
}
