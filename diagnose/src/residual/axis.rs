//! Decoupled parts of a vehicle, with the causes on each.

use whirlstand_vehicle::{Kind, Subsystem};

use crate::model::reach::Reach;
use crate::search::selection::Selection;

/// A part of the vehicle, with the causes on it: nothing that acts elsewhere explains what they explain, and their
/// misfit is nowhere else.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// Indices of the terms that are causes on it. Tones are none: they are credible whatever else there is.
    pub terms: Vec<usize>,
    /// Its states.
    pub states: Vec<usize>,
    /// Its inputs.
    pub inputs: Vec<usize>,
    /// Its channels.
    pub channels: Vec<usize>,
}

impl Axis {
    /// The decoupled parts on which the causes of a selection act: one where all is coupled.
    pub fn all(selection: &Selection<'_, '_>) -> Vec<Self> {
        let (model, values) = (&selection.model, &selection.fit.values);
        let Some((vehicle, effects)) = model.vehicle(values).ok().zip(model.effects(values).ok()) else {
            return Vec::new();
        };
        let data = model.free_run.data;
        let reach = Reach::new(&vehicle, data, model.free.iter().map(|free| &free.target));
        let mut parts: Vec<(Option<Subsystem>, Vec<usize>)> = Vec::new();
        for (term, effect) in effects.iter().enumerate() {
            if model.terms[term].kind == Kind::Vibration {
                continue;
            }
            let part = reach.part_around(reach.of_effect(effect, &vehicle));
            match parts.iter_mut().find(|(other, _)| *other == part) {
                Some((_, terms)) => terms.push(term),
                None => parts.push((part, vec![term])),
            }
        }
        let axis = |(part, terms): (Option<Subsystem>, Vec<usize>)| {
            let part = part.unwrap_or_else(|| Subsystem {
                states: (0..vehicle.states.len()).collect(),
                inputs: (0..vehicle.inputs.len()).collect(),
                outputs: (0..vehicle.outputs.len()).collect(),
            });
            let own = |c: &usize| part.outputs.contains(&data.channels[*c].output);
            let channels = (0..data.channels.len()).filter(own).collect();
            Self { terms, states: part.states, inputs: part.inputs, channels }
        };
        parts.into_iter().map(axis).collect()
    }
}
