//! Names and values of a vehicle's free parameters.

use crate::effects::{Effect, Kind, Matrix};
use crate::error::EffectError;
use crate::free::Target;
use crate::model::Vehicle;

impl Vehicle {
    /// Name of a free parameter: `A[2,1]`, or `input_delay(u_roll).delay_s`.
    pub fn free_name(&self, target: &Target) -> String {
        match target {
            Target::Entry(matrix, i, j) => format!("{matrix:?}[{},{}]", i + 1, j + 1),
            Target::Effect(index, parameter) => match self.effects.get(*index) {
                Some(effect) => format!("{}({}).{parameter}", effect.kind(), effect.place()),
                None => format!("effects[{}].{parameter}", index + 1),
            },
        }
    }

    /// Current value of a free parameter, SI.
    pub fn free_value(&self, target: &Target) -> f64 {
        match *target {
            Target::Entry(Matrix::A, i, j) => self.a[(i, j)],
            Target::Entry(Matrix::B, i, j) => self.b[(i, j)],
            Target::Entry(Matrix::C, i, j) => self.c[(i, j)],
            Target::Entry(Matrix::D, i, j) => self.d[(i, j)],
            Target::Effect(index, name) => {
                self.effects.get(index).and_then(|e| e.parameter(name)).unwrap_or(f64::NAN)
            }
        }
    }

    /// Sets the value of a free parameter, SI.
    ///
    /// # Errors
    /// When the value is invalid for the effect's parameter.
    pub fn set_free(&mut self, target: &Target, value: f64) -> Result<(), EffectError> {
        match *target {
            Target::Entry(Matrix::A, i, j) => self.a[(i, j)] = value,
            Target::Entry(Matrix::B, i, j) => self.b[(i, j)] = value,
            Target::Entry(Matrix::C, i, j) => self.c[(i, j)] = value,
            Target::Entry(Matrix::D, i, j) => self.d[(i, j)] = value,
            Target::Effect(index, name) => {
                if let Some(effect) = self.effects.get_mut(index) {
                    effect.set_parameter(name, value)?;
                }
            }
        }
        Ok(())
    }

    /// SI value of one unit of the vehicle file; 1 for parameters of effects, which are in SI there.
    pub fn free_factor(&self, target: &Target) -> f64 {
        let state = |i: usize| self.states[i].unit.factor();
        let input = |i: usize| self.inputs[i].unit.factor();
        let output = |i: usize| self.outputs[i].unit.factor();
        match *target {
            Target::Entry(Matrix::A, i, j) => state(i) / state(j),
            Target::Entry(Matrix::B, i, j) => state(i) / input(j),
            Target::Entry(Matrix::C, i, j) => output(i) / state(j),
            Target::Entry(Matrix::D, i, j) => output(i) / input(j),
            Target::Effect(..) => 1.0,
        }
    }

    /// Unit of a free parameter in the vehicle file, as shown beside a value; empty for a dimensionless
    /// number.
    pub fn free_unit(&self, target: &Target) -> String {
        match *target {
            Target::Effect(index, name) => self
                .effects
                .get(index)
                .and_then(|e| e.unit(name, self))
                .map_or(String::new(), |u| u.si_symbol()),
            _ => Effect::unit_at(Kind::ParameterChange, &self.free_name(target), "value", self)
                .map_or(String::new(), |u| u.shown_symbol()),
        }
    }

    /// SI unit of a free parameter; empty for a dimensionless number.
    pub fn free_unit_si(&self, target: &Target) -> String {
        match *target {
            Target::Effect(..) => self.free_unit(target),
            _ => Effect::unit_at(Kind::ParameterChange, &self.free_name(target), "value", self)
                .map_or(String::new(), |u| u.si_symbol()),
        }
    }

    /// Weight of an output in a fit; 0 for one that is not fitted. Without `fit` in the file all weights are
    /// 1.
    pub fn fit_weight(&self, output: &str) -> f64 {
        if self.fit.is_empty() {
            return 1.0;
        }
        self.fit.iter().find(|(name, _)| name == output).map_or(0.0, |(_, weight)| *weight)
    }
}
