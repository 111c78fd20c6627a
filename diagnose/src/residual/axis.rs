//! Decoupled parts of a vehicle, with the causes on each.

use whirlstand_vehicle::{Effect, Kind, Matrix, Place, Subsystem, Vehicle};

use crate::data::record::Data;
use crate::model::reach::Reach;
use crate::search::selection::Selection;

/// A part of the vehicle, with the causes on it: nothing that acts elsewhere explains what they explain, and their
/// misfit is nowhere else.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Axis {
    /// Indices of the terms that are causes on it, without tones.
    pub terms: Vec<usize>,
    /// Indices of the tones of its channels: they are credible whatever else there is, unless a force explains them too.
    pub tones: Vec<usize>,
    /// Its states.
    pub states: Vec<usize>,
    /// Its inputs.
    pub inputs: Vec<usize>,
    /// Its channels.
    pub channels: Vec<usize>,
    /// True where two of its causes act on one state or output directly, so that a force there might explain both.
    pub is_shared: bool,
}

impl Axis {
    /// All of the vehicle as one part, without causes.
    pub fn whole(vehicle: &Vehicle, data: &Data) -> Self {
        Self {
            terms: Vec::new(),
            tones: Vec::new(),
            states: (0..vehicle.states.len()).collect(),
            inputs: (0..vehicle.inputs.len()).collect(),
            channels: (0..data.channels.len()).collect(),
            is_shared: false,
        }
    }

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
            let part = reach.part_around(reach.of_effect(effect, &vehicle));
            match parts.iter_mut().find(|(other, _)| *other == part) {
                Some((_, terms)) => terms.push(term),
                None => parts.push((part, vec![term])),
            }
        }
        let axis = |(part, terms): (Option<Subsystem>, Vec<usize>)| {
            let all = Self::whole(&vehicle, data);
            let (states, inputs, channels) = match part {
                Some(part) => {
                    let own = |c: &usize| part.outputs.contains(&data.channels[*c].output);
                    (part.states, part.inputs, all.channels.into_iter().filter(own).collect())
                }
                None => (all.states, all.inputs, all.channels),
            };
            let tone = |term: &usize| model.terms[*term].kind == Kind::Vibration;
            let (tones, terms): (Vec<usize>, Vec<usize>) = terms.into_iter().partition(tone);
            let acted: Vec<usize> =
                terms.iter().flat_map(|term| acts_on(&effects[*term], &vehicle)).collect();
            let is_shared = (1..acted.len()).any(|i| acted[..i].contains(&acted[i]));
            Self { terms, tones, states, inputs, channels, is_shared }
        };
        parts.into_iter().map(axis).collect()
    }
}

/// The states and, after them, the outputs on which an effect acts directly, each once.
fn acts_on(effect: &Effect, vehicle: &Vehicle) -> Vec<usize> {
    let n = vehicle.states.len();
    let of_input = |j: usize| -> Vec<usize> {
        let (states, outputs) = (vehicle.b.column(j), vehicle.d.column(j));
        let entries = states.iter().chain(outputs.iter()).enumerate();
        entries.filter(|(_, entry)| **entry != 0.0).map(|(i, _)| i).collect()
    };
    match effect.resolve(vehicle).unwrap_or(Place::Vehicle) {
        Place::State(i) | Place::StatePair(_, i) | Place::Entry(Matrix::A | Matrix::B, i, _) => vec![i],
        Place::Output(i) | Place::Entry(Matrix::C | Matrix::D, i, _) => vec![n + i],
        Place::OutputPair(a, b) => vec![n + a, n + b],
        Place::Input(j) | Place::InputPair(_, j) => of_input(j),
        Place::Vehicle => (0..n + vehicle.outputs.len()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::acts_on;
    use whirlstand_vehicle::{Effect, Kind, Vehicle};

    /// Roll, roll rate, pitch, pitch rate: u_roll drives both rates, u_pitch that of pitch.
    #[test]
    fn effects_act_on_states_and_outputs() {
        let quadrotor = Vehicle::builtin("quadrotor").unwrap();
        let on = |kind, place, name| acts_on(&Effect::new(kind, place, &[(name, 0.1)]).unwrap(), &quadrotor);
        assert_eq!(on(Kind::InputGain, "u_roll", "factor"), [1, 3]);
        assert_eq!(on(Kind::InputCoupling, "u_roll->u_pitch", "coefficient"), [3]);
        assert_eq!(on(Kind::CubicStiffness, "pitch->roll_rate", "coefficient"), [1]);
        assert_eq!(on(Kind::ParameterChange, "A[4,1]", "value"), [3]);
        assert_eq!(on(Kind::SensorLag, "pitch", "time_constant_s"), [6]);
    }
}
