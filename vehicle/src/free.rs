//! What identification may change: free matrix entries, free parameters of effects, and which signals are fitted.

use std::fmt;

use crate::effects::{Effect, Matrix};
use crate::error::EffectError;
use crate::model::Vehicle;

/// What a free parameter stands for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// Entry of a matrix: matrix, row and column from 0.
    Entry(Matrix, usize, usize),
    /// Parameter of an effect: index in [`Vehicle::effects`] and the parameter's name.
    Effect(usize, &'static str),
}

/// A free parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct Free {
    /// What it stands for.
    pub target: Target,
    /// Least value, SI.
    pub lower: f64,
    /// Greatest value, SI.
    pub upper: f64,
    /// Where the search starts, SI; `None` when the data shall give the start.
    pub start: Option<f64>,
}

/// Where a fitted vehicle comes from: key and value, in the order in which they are written.
pub type Provenance = Vec<(String, String)>;

impl Vehicle {
    /// The name of a free parameter: `A[2,1]`, or `input_delay(u_roll).delay_s`.
    pub fn free_name(&self, target: &Target) -> String {
        match target {
            Target::Entry(matrix, i, j) => format!("{matrix:?}[{},{}]", i + 1, j + 1),
            Target::Effect(index, parameter) => match self.effects.get(*index) {
                Some(effect) => format!("{}({}).{parameter}", effect.kind(), effect.place()),
                None => format!("effects[{}].{parameter}", index + 1),
            },
        }
    }

    /// The value that a free parameter has now, SI.
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

    /// Gives a free parameter a value, SI.
    ///
    /// # Errors
    /// When the effect's parameter cannot have that value.
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

    /// SI value of one in the unit of the vehicle file; 1 for parameters of effects, which are in SI there.
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

    /// Weight of an output in a fit; 0 for one that is not fitted. Without `fit` in the file all weigh 1.
    pub fn fit_weight(&self, output: &str) -> f64 {
        if self.fit.is_empty() {
            return 1.0;
        }
        self.fit.iter().find(|(name, _)| name == output).map_or(0.0, |(_, weight)| *weight)
    }
}

impl Effect {
    /// The range in which the table allows a parameter, SI.
    pub fn range(&self, name: &str) -> Option<(f64, f64)> {
        let parameter = self.kind().spec().parameters.iter().find(|p| p.name == name)?;
        Some((parameter.lower, parameter.upper))
    }
}

impl fmt::Display for Matrix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self:?}")
    }
}
