//! Variants of a vehicle with some of its effects switched off: every combination of effects that change its
//! matrices, delays or output rows.

use super::compile::{Row, System};
use super::switch::Switch;
use crate::effects::{Effect, Kind, Place};
use crate::error::SimulatorError;
use crate::model::Vehicle;

/// Largest number of such switchable effects in a vehicle; the number of matrices is two to the power of it.
const MOST: usize = 6;

/// True when switching the effect changes matrices or delays.
fn is_chosen(effect: &Effect) -> bool {
    let kind = matches!(
        effect.kind(),
        Kind::InputDelay
            | Kind::ActuatorLag
            | Kind::InputCoupling
            | Kind::ParameterChange
            | Kind::UnmodelledMode
            | Kind::ModeTransition
            | Kind::SensorDelay
            | Kind::SensorLag
    );
    kind && !effect.window().is_always()
}

/// One combination of switched effects.
#[derive(Debug, Clone)]
pub struct Combination {
    /// For each effect of the vehicle that is switched this way, whether it acts.
    acts: Vec<bool>,
    /// The augmented system; its states are the same in all combinations.
    pub system: System,
}

/// The switches, and the vehicle's model for each combination of them.
#[derive(Debug, Clone)]
pub struct Combinations {
    /// The switches, in the order of the effects.
    pub switches: Vec<Switch>,
    /// All combinations; bit i of the index means that switch i is on.
    pub all: Vec<Combination>,
}

impl Combinations {
    /// Compiles all combinations.
    ///
    /// # Errors
    /// When more effects are switched than the largest number, or one does not fit.
    pub fn new(vehicle: &Vehicle, effects: &[(Effect, Place)]) -> Result<Self, SimulatorError> {
        let chosen: Vec<usize> = (0..effects.len()).filter(|i| is_chosen(&effects[*i].0)).collect();
        if chosen.len() > MOST {
            return Err(SimulatorError::Windows { found: chosen.len(), most: MOST });
        }
        let combination = |bits: usize| {
            let mut acts = vec![true; effects.len()];
            chosen.iter().enumerate().for_each(|(bit, index)| acts[*index] = bits >> bit & 1 == 1);
            Ok(Combination { system: System::new(vehicle, effects, &acts)?, acts })
        };
        Ok(Self {
            switches: chosen.iter().map(|index| Switch::new(*index, &effects[*index].0)).collect(),
            all: (0..1 << chosen.len()).map(combination).collect::<Result<_, SimulatorError>>()?,
        })
    }

    /// Total delay of a kind at a place, for every combination.
    pub fn delays_s(&self, effects: &[(Effect, Place)], kind: Kind, at: Place) -> Vec<f64> {
        let meant = |(effect, place): &(Effect, Place)| effect.kind() == kind && *place == at;
        let of = |one: &Combination| {
            let acting = effects.iter().zip(&one.acts).filter(|(e, acts)| **acts && meant(e));
            acting.map(|((effect, _), _)| effect.get("delay_s")).sum()
        };
        self.all.iter().map(of).collect()
    }

    /// Rows of an output, without and with lags, for every combination.
    pub fn rows(&self, output: usize) -> Vec<(Row, Row)> {
        self.all.iter().map(|one| one.system.outputs[output].clone()).collect()
    }
}
