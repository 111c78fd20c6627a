//! A decoupled part of a vehicle with its part of a record.

use std::sync::Arc;

use whirlstand_vehicle::{Subsystem, Vehicle};

use crate::data::record::{Channel, Data};
use crate::model::observer::Observer;

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
        Self { vehicle: subsystem.vehicle(vehicle), subsystem, channels: indices, data, observer }
    }
}
