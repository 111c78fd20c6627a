//! Adds effects to a vehicle, and resolves the target of a mode transition.

use nalgebra::DMatrix;

use crate::effects::{Effect, Place};
use crate::error::EffectError;
use crate::model::Vehicle;

impl Vehicle {
    /// Adds an effect.
    ///
    /// # Errors
    /// When its place does not exist in the vehicle, its units do not fit, or the vehicle of a mode transition cannot be
    /// found or has other states or inputs.
    pub fn add_effect(&mut self, effect: Effect) -> Result<(), EffectError> {
        self.check_effect(&effect)?;
        self.effects.push(effect.confirmed());
        Ok(())
    }

    /// Adds an effect as written in a file.
    ///
    /// # Errors
    /// As [`Vehicle::add_effect`], and when a number without a unit is ambiguous.
    pub fn add_written_effect(&mut self, effect: Effect) -> Result<(), EffectError> {
        self.check_written_effect(&effect)?;
        self.effects.push(effect.confirmed());
        Ok(())
    }

    pub(crate) fn check_written_effect(&self, effect: &Effect) -> Result<(), EffectError> {
        let place = self.check_effect(effect)?;
        effect.check_bare(self, place)
    }

    pub(crate) fn check_effect(&self, effect: &Effect) -> Result<Place, EffectError> {
        let place = effect.resolve(self)?;
        if effect.kind() == crate::effects::Kind::ModeTransition {
            self.successor(effect)?;
        }
        Ok(place)
    }

    /// A and B of the target vehicle of a mode transition, in the order of this vehicle's states and inputs.
    ///
    /// # Errors
    /// When the vehicle cannot be found, or lacks one of the states or inputs, or has more.
    pub(crate) fn successor(&self, effect: &Effect) -> Result<(DMatrix<f64>, DMatrix<f64>), EffectError> {
        let fail = |reason: String| EffectError {
            effect: effect.kind().name().into(),
            place: effect.place().into(),
            field: Some("to".into()),
            reason,
        };
        let to = effect.text().unwrap_or_default();
        let next = Self::find_from(to, self.folder.as_deref()).map_err(|e| fail(format!("is wrong: {e}")))?;
        let order = |what: &str, own: Vec<&str>, other: Vec<&str>| {
            if own.len() != other.len() {
                let list = |names: &[&str]| crate::error::list(names.iter().copied());
                let (own, other) = (list(&own), list(&other));
                return Err(fail(format!(
                    "'{to}' has different {what}s: it has {other}, but {own} are needed"
                )));
            }
            own.iter()
                .map(|name| {
                    other
                        .iter()
                        .position(|n| n == name)
                        .ok_or_else(|| fail(format!("'{to}' has no {what} '{name}', which this vehicle has")))
                })
                .collect::<Result<Vec<_>, _>>()
        };
        let names = |v: &'_ Self| v.states.iter().map(|s| s.name.clone()).collect::<Vec<_>>();
        let input_names = |v: &'_ Self| v.inputs.iter().map(|s| s.name.clone()).collect::<Vec<_>>();
        fn refs(names: &[String]) -> Vec<&str> {
            names.iter().map(String::as_str).collect()
        }
        let states = order("state", refs(&names(self)), refs(&names(&next)))?;
        let inputs = order("input", refs(&input_names(self)), refs(&input_names(&next)))?;
        let a = DMatrix::from_fn(states.len(), states.len(), |i, j| next.a[(states[i], states[j])]);
        let b = DMatrix::from_fn(states.len(), inputs.len(), |i, j| next.b[(states[i], inputs[j])]);
        Ok((a, b))
    }
}
